"""Functions of the C library as arithmetic on a tape: all runs of a vector at once, and on any
device.

`lowered` writes a tape anew with them. They are within two units in the last place of the C
library's (three for the tangent and for hyperbolic sine and tangent), a power ``x^y`` within
``2 + 2 |y log x|`` units. Whole powers of whole numbers, and their logarithms to base 2 and 10, are
exact, and so are remainders. An argument of sine and cosine beyond 1e14 rad, and a remainder of
2^53 periods, give nan: a run that is lost is flown again by the numpy engine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import factorial, inf, nan, pi

from celnav.tape.tape import Number, Scalar, Tape, as_number, do

FARTHEST = 1e14  # rad; one float is a hundredth of a radian from the next there
LOG10_2 = (3.01029995663611771306e-01, 3.69423907715893078616e-13)
LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
HALF_PI = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591833e-33)
"""As sums, the first of which is as much as a float holds (of the logarithm: with zeros at its
end).
"""
_SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
_EXP = tuple(1.0 / factorial(k) for k in range(14))
_LOG = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860511658591e-01,
)
_ATAN = (
    -6.485021904942025371773e1,
    -1.228866684490136173410e2,
    -7.500855792314704667340e1,
    -1.615753718733365076637e1,
    -8.750608600031904122785e-1,
)
_ATAN_BELOW = (
    1.945506571482613964425e2,
    4.853903996359136964868e2,
    4.328810604912902668951e2,
    1.650270098316988542046e2,
    2.485846490142306297962e1,
    1.0,
)
"""Polynomials on the reduced ranges, by rising powers [fdlibm; Cephes]."""


def lowered(tape: Tape, outputs: Sequence[Number]) -> tuple[Tape, dict[int, Scalar]]:
    """A tape without these functions, and what has become of each number that the outputs need."""
    new = Tape()
    known: dict[int, Scalar] = {}
    for i in tape.needed(outputs):
        name, *at = tape.ops[i]
        if name == "in":
            known[i] = new.node("in", at[0])
            new.absent[known[i].i] = tape.absent[i]
        elif name == "const":
            known[i] = at[0]
        elif name == "call":
            known[i] = new.node(
                name, at[0].lowered(), *(new.lift(as_number(known[a])).i for a in at[1:])
            )
        elif name == "part":
            known[i] = new.node(name, known[at[0]].i, at[1])
        else:
            own = LOWERED.get(name)
            values = [known[a] for a in at]
            known[i] = own(*values) if own else new.node(name, *(new.lift(x).i for x in values))
        if i in tape.sharp and type(known[i]) is Number:
            new.sharp.add(known[i].i)
    return new, known


def _polynomial(x: Scalar, coefficients: Sequence[float]) -> Scalar:
    out: Scalar = coefficients[-1]
    for c in coefficients[-2::-1]:
        out = do("add", do("mul", out, x), c)
    return out


def _select(condition: Scalar, a: Scalar, b: Scalar) -> Scalar:
    return do("select", condition, a, b)


def _quarters(x: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Sine and cosine of what is left of an angle after whole quarters of a turn, their number
    modulo 4, and whether it is odd.
    """
    n = do("rint", do("mul", x, 2.0 / pi))
    r = x
    for part in HALF_PI:
        r = do("sub", r, do("mul", n, part))
    r = _select(do("le", do("abs", x), FARTHEST), r, nan)
    z = do("mul", r, r)
    sine = do("add", r, do("mul", do("mul", r, z), _polynomial(z, _SINE)))
    cosine = do(
        "add",
        do("sub", 1.0, do("mul", 0.5, z)),
        do("mul", do("mul", z, z), _polynomial(z, _COSINE)),
    )
    q = do("sub", n, do("mul", 4.0, do("floor", do("mul", n, 0.25))))
    return sine, cosine, q, do("or", do("eq", q, 1.0), do("eq", q, 3.0))


def sin(x: Scalar) -> Scalar:
    """Sine."""
    s, c, q, odd = _quarters(x)
    value = _select(odd, c, s)
    return _select(do("lt", q, 2.0), value, do("neg", value))


def cos(x: Scalar) -> Scalar:
    """Cosine."""
    s, c, q, odd = _quarters(x)
    value = _select(odd, s, c)
    return _select(do("or", do("eq", q, 1.0), do("eq", q, 2.0)), do("neg", value), value)


def exp(x: Scalar) -> Scalar:
    """Exponential: of ``x = n ln 2 + r``, 2 to the n times a polynomial of r."""
    n = do(
        "rint",
        do(
            "mul",
            _select(do("lt", do("abs", x), 800.0), x, do("copysign", 800.0, x)),
            1.4426950408889634,
        ),
    )
    value = _times_pow2(
        _polynomial(do("sub", do("sub", x, do("mul", n, LN2[0])), do("mul", n, LN2[1])), _EXP), n
    )
    return _select(
        do("lt", x, -745.1332191019412), 0.0, _select(do("lt", 709.782712893384, x), inf, value)
    )


def exp2(x: Scalar) -> Scalar:
    """Two to the power of a number."""
    n = do("rint", _select(do("lt", do("abs", x), 1100.0), x, do("copysign", 1100.0, x)))
    value = _times_pow2(_polynomial(do("mul", do("sub", x, n), 0.6931471805599453), _EXP), n)
    return _select(
        do("lt", x, -1074.0), 0.0, _select(do("lt", x, 1024.0), value, do("mul", x, inf))
    )


def _times_pow2(x: Scalar, n: Scalar) -> Scalar:
    """``x 2^n``, in two factors, since one of them may not be a normal number."""
    half = do("floor", do("mul", n, 0.5))
    return do("mul", do("mul", x, do("pow2", half)), do("pow2", do("sub", n, half)))


def _less_one(x: Scalar) -> tuple[Scalar, Scalar]:
    """Numbers m and n, with which the exponential less one is ``m 2^n``:
    ``m = (e^r - 1) + (1 - 2^-n)``, of ``x = n ln 2 + r``.
    """
    x = _select(do("lt", 800.0, do("abs", x)), do("copysign", 800.0, x), x)
    n = do("rint", do("mul", x, 1.4426950408889634))
    r = do("sub", do("sub", x, do("mul", n, LN2[0])), do("mul", n, LN2[1]))
    clipped = _select(do("lt", 60.0, do("abs", n)), do("copysign", 60.0, n), n)
    return do(
        "add",
        do("mul", r, _polynomial(r, _EXP[1:])),
        do("sub", 1.0, do("pow2", do("neg", clipped))),
    ), n


def expm1(x: Scalar) -> Scalar:
    """Exponential less one."""
    return _select(do("lt", x, -40.0), -1.0, _times_pow2(*_less_one(x)))


def sinh(x: Scalar) -> Scalar:
    """Hyperbolic sine: ``t + t / (2 t + 1)``, with t half of the exponential less one."""
    size = do("abs", x)
    m, n = _less_one(size)
    t = _times_pow2(m, do("sub", n, 1.0))
    rest = _select(do("lt", t, 1e20), do("div", t, do("add", do("add", t, t), 1.0)), 0.0)
    return do(
        "copysign", _select(do("lt", size, 1e-9), size, do("add", t, rest)), x
    )  # half of a small number may have lost a bit


def cosh(x: Scalar) -> Scalar:
    """Hyperbolic cosine: ``h + 1 / (4 h)``, with h half of the exponential."""
    m, n = _less_one(do("abs", x))
    h = do("add", _times_pow2(m, do("sub", n, 1.0)), 0.5)
    return do("add", h, do("div", 0.25, h))


def tanh(x: Scalar) -> Scalar:
    """Hyperbolic tangent: ``t / (t + 2)``, with t the exponential of 2 x less one."""
    size = do("abs", x)
    t = _times_pow2(*_less_one(do("add", size, size)))
    return do("copysign", _select(do("lt", 22.0, size), 1.0, do("div", t, do("add", t, 2.0))), x)


def log1p(x: Scalar) -> Scalar:
    """Logarithm of one more: of the sum as it is rounded, and what that lacks."""
    more = do("add", 1.0, x)
    inside = do("and", do("lt", 0.0, more), do("lt", more, inf))
    return do(
        "add", log(more), _select(inside, do("div", do("sub", x, do("sub", more, 1.0)), more), 0.0)
    )


def cbrt(x: Scalar) -> Scalar:
    """Cube root, by logarithm, and a step of Newton's."""
    size = do("abs", x)
    y = exp(do("mul", log(size), 1.0 / 3.0))
    y = do("sub", y, do("mul", do("sub", y, do("div", size, do("mul", y, y))), 1.0 / 3.0))
    return _select(do("and", do("lt", 0.0, size), do("lt", size, inf)), do("copysign", y, x), x)


def _near_one(x: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Of ``x = 2^k m``, with m near 1: k, and numbers f, a and b, with which
    ``log m = f - (a - b)``, by ``2 artanh``.
    """
    small = do("lt", x, 1e-300)
    whole = _select(small, do("mul", x, 2.0**54), x)
    k = do("exponent", whole)
    m = _times_pow2(whole, do("neg", k))
    large = do("lt", 1.4142135623730951, m)
    m, k = _select(large, do("mul", 0.5, m), m), do("add", k, _select(large, 1.0, 0.0))
    k = do("sub", k, _select(small, 54.0, 0.0))
    f = do("sub", m, 1.0)
    s = do("div", f, do("add", 2.0, f))
    z = do("mul", s, s)
    series, square = do("mul", z, _polynomial(z, _LOG)), do("mul", 0.5, do("mul", f, f))
    return k, f, square, do("mul", s, do("add", square, series))


def _logarithm(x: Scalar, value: Scalar) -> Scalar:
    """The value where x is positive and finite."""
    value = _select(do("lt", x, inf), value, x)
    return _select(do("lt", 0.0, x), value, _select(do("eq", x, 0.0), -inf, nan))


def log(x: Scalar) -> Scalar:
    """Logarithm."""
    k, f, a, b = _near_one(x)
    rest = do("sub", a, do("add", b, do("mul", k, LN2[1])))
    return _logarithm(x, do("sub", do("mul", k, LN2[0]), do("sub", rest, f)))


def log2(x: Scalar) -> Scalar:
    """Logarithm to base 2, exact of its powers."""
    k, f, a, b = _near_one(x)
    part = do("mul", do("sub", f, do("sub", a, b)), 1.4426950408889634)
    return _logarithm(x, do("add", k, part))


def log10(x: Scalar) -> Scalar:
    """Logarithm to base 10, exact of its powers."""
    k, f, a, b = _near_one(x)
    part = do("mul", do("sub", f, do("sub", a, b)), 0.4342944819032518)
    part = do("add", do("mul", k, LOG10_2[1]), part)
    return _logarithm(x, do("add", do("mul", k, LOG10_2[0]), part))


def power(x: Scalar, y: Scalar) -> Scalar:
    """``x^y``: by squares for whole y below 128, by logarithm for others."""
    size, whole = do("abs", x), do("eq", do("floor", y), y)
    rest, square, product = do("abs", y), x, 1.0
    for _ in range(7):
        half = do("floor", do("mul", 0.5, rest))
        odd = do("eq", do("sub", rest, do("add", half, half)), 1.0)
        product = _select(odd, do("mul", product, square), product)
        rest, square = half, do("mul", square, square)
    product = _select(do("lt", y, 0.0), do("div", 1.0, product), product)
    value = _select(do("eq", size, 1.0), 1.0, exp(do("mul", y, log(size))))
    half = do("mul", 0.5, y)
    value = _select(
        do("lt", x, 0.0),
        _select(whole, _select(do("eq", do("floor", half), half), value, do("neg", value)), nan),
        value,
    )
    return _select(do("and", whole, do("eq", rest, 0.0)), product, value)


def fmod(x: Scalar, y: Scalar) -> Scalar:
    """Remainder of the sign of x: exact, since what a fused product leaves of a quotient is."""
    size, period = do("abs", x), do("abs", y)
    ratio = do("div", size, period)
    left = do("fma", do("floor", ratio), do("neg", period), size)
    left = _select(do("lt", left, 0.0), do("add", left, period), left)  # the ratio was rounded up
    left = _select(do("lt", ratio, 2.0**53), left, nan)
    return do("copysign", _select(do("lt", size, period), size, left), x)


def hypot(x: Scalar, y: Scalar) -> Scalar:
    """Length: squares that would leave the range of floats are taken of scaled numbers."""
    square = do("add", do("mul", x, x), do("mul", y, y))
    far, near = do("lt", 1e300, square), do("lt", square, 1e-280)
    down, up = (_select(far, c, _select(near, 1.0 / c, 1.0)) for c in (2.0**-600, 2.0**600))
    a, b = do("mul", x, down), do("mul", y, down)
    return do("mul", do("sqrt", do("add", do("mul", a, a), do("mul", b, b))), up)


def atan2(y: Scalar, x: Scalar) -> Scalar:
    """Angle of a point, from -pi to pi."""
    across, along = do("abs", y), do("abs", x)
    steep = do("lt", along, across)
    low, high = _select(steep, along, across), _select(steep, across, along)
    t = do("div", low, _select(do("eq", high, 0.0), 1.0, high))
    t = _select(do("and", do("eq", low, inf), do("eq", high, inf)), 1.0, t)
    beyond = do("lt", 0.66, t)
    t = _select(beyond, do("div", do("sub", t, 1.0), do("add", t, 1.0)), t)
    z = do("mul", t, t)
    ratio = do("div", do("mul", z, _polynomial(z, _ATAN)), _polynomial(z, _ATAN_BELOW))
    angle = do("add", do("mul", t, ratio), t)
    angle = do("add", angle, _select(beyond, 0.25 * pi, 0.0))
    angle = _select(steep, do("sub", 0.5 * pi, angle), angle)
    behind = do("lt", do("copysign", 1.0, x), 0.0)
    return do("copysign", _select(behind, do("sub", pi, angle), angle), y)


def _root(x: Scalar) -> Scalar:
    """Of ``1 - x^2``, by factors: it keeps its digits near 1."""
    return do("sqrt", do("mul", do("sub", 1.0, x), do("add", 1.0, x)))


LOWERED: dict[str, Callable[..., Scalar]] = {
    "sin": sin,
    "cos": cos,
    "tan": lambda x: do("div", sin(x), cos(x)),
    "exp": exp,
    "exp2": exp2,
    "log": log,
    "log2": log2,
    "log10": log10,
    "atan2": atan2,
    "atan": lambda x: atan2(x, 1.0),
    "asin": lambda x: atan2(x, _root(x)),
    "acos": lambda x: atan2(_root(x), x),
    "pow": power,
    "fmod": fmod,
    "hypot": hypot,
    "expm1": expm1,
    "log1p": log1p,
    "sinh": sinh,
    "cosh": cosh,
    "tanh": tanh,
    "cbrt": cbrt,
}
"""Name of the C library's function -> ours."""
