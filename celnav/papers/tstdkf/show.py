FIGURES = TABLES = {}
RECORDINGS = []
def record(*a): return []
