"""Functions of the C library as arithmetic on a tape: for all runs of a vector at once, and on any
device.

`expand_elementary` rewrites a tape with them. They differ from the C library by at most two units
in the last place (three for the tangent and for hyperbolic sine and tangent); a power ``x^y``
differs by at most ``2 + 2 |y log x|`` units. Integer powers of integers, logarithms of powers of 2
and 10 to these bases, and remainders are exact. An argument of sine and cosine beyond 1e14 rad, and
a remainder of 2^53 periods, give nan: the run fails, and the numpy engine repeats it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import factorial, inf, nan, pi

from celnav.tape.tape import Scalar, Tape, TracedScalar, as_number, emit

FARTHEST = 1e14  # rad; there neighboring floats differ by a hundredth of a radian
LOG10_2 = (3.01029995663611771306e-01, 3.69423907715893078616e-13)
LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
HALF_PI = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591833e-33)
"""Constants as sums of floats; the first term is the nearest float (the first terms of logarithms
end with zero bits).
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


def expand_elementary(
    tape: Tape, outputs: Sequence[TracedScalar]
) -> tuple[Tape, dict[int, Scalar]]:
    """A tape without these functions, and for each number that the outputs need its number on the
    new tape.
    """
    new = Tape()
    mapped: dict[int, Scalar] = {}
    for i in tape.needed(outputs):
        name, *at = tape.ops[i]
        if name == "in":
            mapped[i] = new.node("in", at[0])
            new.absent[mapped[i].i] = tape.absent[i]
        elif name == "const":
            mapped[i] = at[0]
        elif name == "call":
            mapped[i] = new.node(
                name, at[0].expanded(), *(new.lift(as_number(mapped[a])).i for a in at[1:])
            )
        elif name == "part":
            mapped[i] = new.node(name, mapped[at[0]].i, at[1])
        else:
            expansion = EXPANSIONS.get(name)
            values = [mapped[a] for a in at]
            mapped[i] = (
                expansion(*values)
                if expansion
                else new.node(name, *(new.lift(x).i for x in values))
            )
        if i in tape.sharp and type(mapped[i]) is TracedScalar:
            new.sharp.add(mapped[i].i)
    return new, mapped


def _polynomial(x: Scalar, coefficients: Sequence[float]) -> Scalar:
    out: Scalar = coefficients[-1]
    for c in coefficients[-2::-1]:
        out = emit("add", emit("mul", out, x), c)
    return out


def _select(condition: Scalar, a: Scalar, b: Scalar) -> Scalar:
    return emit("select", condition, a, b)


def _quarters(x: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Sine and cosine of an angle's remainder after n quarter turns, n modulo 4, and whether n is
    odd.
    """
    # x = n pi/2 + r; pi/2 is a sum of three floats, so that r keeps its digits.
    n = emit("rint", emit("mul", x, 2.0 / pi))
    r = x
    for term in HALF_PI:
        r = emit("sub", r, emit("mul", n, term))
    r = _select(emit("le", emit("abs", x), FARTHEST), r, nan)
    z = emit("mul", r, r)
    # sin r = r + r z P(z), and cos r = 1 - z / 2 + z^2 Q(z), with z = r^2.
    sine = emit("add", r, emit("mul", emit("mul", r, z), _polynomial(z, _SINE)))
    cosine = emit(
        "add",
        emit("sub", 1.0, emit("mul", 0.5, z)),
        emit("mul", emit("mul", z, z), _polynomial(z, _COSINE)),
    )
    q = emit("sub", n, emit("mul", 4.0, emit("floor", emit("mul", n, 0.25))))
    return sine, cosine, q, emit("or", emit("eq", q, 1.0), emit("eq", q, 3.0))


def sin(x: Scalar) -> Scalar:
    """Sine."""
    s, c, q, odd = _quarters(x)
    value = _select(odd, c, s)
    return _select(emit("lt", q, 2.0), value, emit("neg", value))


def cos(x: Scalar) -> Scalar:
    """Cosine."""
    s, c, q, odd = _quarters(x)
    value = _select(odd, s, c)
    return _select(emit("or", emit("eq", q, 1.0), emit("eq", q, 2.0)), emit("neg", value), value)


def exp(x: Scalar) -> Scalar:
    """Exponential: with ``x = n ln 2 + r``, 2 to the n times a polynomial of r."""
    n = emit(
        "rint",
        emit(
            "mul",
            _select(emit("lt", emit("abs", x), 800.0), x, emit("copysign", 800.0, x)),
            1.4426950408889634,
        ),
    )
    value = _times_pow2(
        _polynomial(
            emit("sub", emit("sub", x, emit("mul", n, LN2[0])), emit("mul", n, LN2[1])), _EXP
        ),
        n,
    )
    return _select(
        emit("lt", x, -745.1332191019412), 0.0, _select(emit("lt", 709.782712893384, x), inf, value)
    )


def exp2(x: Scalar) -> Scalar:
    """Two to the power x."""
    n = emit("rint", _select(emit("lt", emit("abs", x), 1100.0), x, emit("copysign", 1100.0, x)))
    # 2^x = 2^n exp((x - n) ln 2)
    value = _times_pow2(_polynomial(emit("mul", emit("sub", x, n), 0.6931471805599453), _EXP), n)
    return _select(
        emit("lt", x, -1074.0), 0.0, _select(emit("lt", x, 1024.0), value, emit("mul", x, inf))
    )


def _times_pow2(x: Scalar, n: Scalar) -> Scalar:
    """``x 2^n``, with two factors, because ``2^n`` may not be a normal number."""
    half = emit("floor", emit("mul", n, 0.5))
    return emit("mul", emit("mul", x, emit("pow2", half)), emit("pow2", emit("sub", n, half)))


def _less_one(x: Scalar) -> tuple[Scalar, Scalar]:
    """Numbers m and n with ``e^x - 1 = m 2^n``: for ``x = n ln 2 + r``,
    ``m = (e^r - 1) + (1 - 2^-n)``.
    """
    x = _select(emit("lt", 800.0, emit("abs", x)), emit("copysign", 800.0, x), x)
    n = emit("rint", emit("mul", x, 1.4426950408889634))
    r = emit("sub", emit("sub", x, emit("mul", n, LN2[0])), emit("mul", n, LN2[1]))
    # For |n| > 60 the term 2^-n is negligible or dominant: its exponent may be clipped.
    clipped = _select(emit("lt", 60.0, emit("abs", n)), emit("copysign", 60.0, n), n)
    return emit(
        "add",
        emit("mul", r, _polynomial(r, _EXP[1:])),
        emit("sub", 1.0, emit("pow2", emit("neg", clipped))),
    ), n


def expm1(x: Scalar) -> Scalar:
    """Exponential minus one."""
    return _select(emit("lt", x, -40.0), -1.0, _times_pow2(*_less_one(x)))


def sinh(x: Scalar) -> Scalar:
    """Hyperbolic sine: ``t + t / (2 t + 1)``, with ``t = (e^x - 1) / 2``."""
    size = emit("abs", x)
    m, n = _less_one(size)
    t = _times_pow2(m, emit("sub", n, 1.0))
    rest = _select(emit("lt", t, 1e20), emit("div", t, emit("add", emit("add", t, t), 1.0)), 0.0)
    # Half of a very small number may have lost a bit: return the number.
    return emit("copysign", _select(emit("lt", size, 1e-9), size, emit("add", t, rest)), x)


def cosh(x: Scalar) -> Scalar:
    """Hyperbolic cosine: ``h + 1 / (4 h)``, with ``h = e^x / 2``."""
    m, n = _less_one(emit("abs", x))
    h = emit("add", _times_pow2(m, emit("sub", n, 1.0)), 0.5)
    return emit("add", h, emit("div", 0.25, h))


def tanh(x: Scalar) -> Scalar:
    """Hyperbolic tangent: ``t / (t + 2)``, with ``t = e^(2 x) - 1``."""
    size = emit("abs", x)
    t = _times_pow2(*_less_one(emit("add", size, size)))
    return emit(
        "copysign", _select(emit("lt", 22.0, size), 1.0, emit("div", t, emit("add", t, 2.0))), x
    )


def log1p(x: Scalar) -> Scalar:
    """Logarithm of 1 + x: the logarithm of the rounded sum, plus a correction for the rounding
    error.
    """
    more = emit("add", 1.0, x)
    inside = emit("and", emit("lt", 0.0, more), emit("lt", more, inf))
    return emit(
        "add",
        log(more),
        _select(inside, emit("div", emit("sub", x, emit("sub", more, 1.0)), more), 0.0),
    )


def cbrt(x: Scalar) -> Scalar:
    """Cube root, by logarithm and one Newton step."""
    size = emit("abs", x)
    y = exp(emit("mul", log(size), 1.0 / 3.0))
    # Newton: y - (y - |x| / y^2) / 3
    y = emit("sub", y, emit("mul", emit("sub", y, emit("div", size, emit("mul", y, y))), 1.0 / 3.0))
    return _select(
        emit("and", emit("lt", 0.0, size), emit("lt", size, inf)), emit("copysign", y, x), x
    )


def _near_one(x: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """For ``x = 2^k m``, with m near 1: k, and numbers f, a and b with ``log m = f - (a - b)``, by
    ``2 artanh``.
    """
    # With s = f / (2 + f): log(1 + f) = f - (f^2 / 2 - s (f^2 / 2 + R(s^2))).
    small = emit("lt", x, 1e-300)
    # Very small numbers, which may be subnormal, are scaled by 2^54.
    whole = _select(small, emit("mul", x, 2.0**54), x)
    k = emit("exponent", whole)
    m = _times_pow2(whole, emit("neg", k))
    large = emit("lt", 1.4142135623730951, m)
    # Keep m between sqrt(1/2) and sqrt(2).
    m, k = _select(large, emit("mul", 0.5, m), m), emit("add", k, _select(large, 1.0, 0.0))
    k = emit("sub", k, _select(small, 54.0, 0.0))
    f = emit("sub", m, 1.0)
    s = emit("div", f, emit("add", 2.0, f))
    z = emit("mul", s, s)
    series, square = emit("mul", z, _polynomial(z, _LOG)), emit("mul", 0.5, emit("mul", f, f))
    return k, f, square, emit("mul", s, emit("add", square, series))


def _logarithm(x: Scalar, value: Scalar) -> Scalar:
    """The logarithm of x, from its ``value`` for positive and finite x."""
    value = _select(emit("lt", x, inf), value, x)
    return _select(emit("lt", 0.0, x), value, _select(emit("eq", x, 0.0), -inf, nan))


def log(x: Scalar) -> Scalar:
    """Logarithm."""
    k, f, a, b = _near_one(x)
    # log x = k ln 2 + f - (a - b), with ln 2 as the sum of two floats.
    rest = emit("sub", a, emit("add", b, emit("mul", k, LN2[1])))
    return _logarithm(x, emit("sub", emit("mul", k, LN2[0]), emit("sub", rest, f)))


def log2(x: Scalar) -> Scalar:
    """Logarithm to base 2, exact for powers of 2."""
    k, f, a, b = _near_one(x)
    fraction = emit("mul", emit("sub", f, emit("sub", a, b)), 1.4426950408889634)
    return _logarithm(x, emit("add", k, fraction))


def log10(x: Scalar) -> Scalar:
    """Logarithm to base 10, exact for powers of 10."""
    k, f, a, b = _near_one(x)
    fraction = emit("mul", emit("sub", f, emit("sub", a, b)), 0.4342944819032518)
    fraction = emit("add", emit("mul", k, LOG10_2[1]), fraction)
    return _logarithm(x, emit("add", emit("mul", k, LOG10_2[0]), fraction))


def power(x: Scalar, y: Scalar) -> Scalar:
    """``x^y``: by repeated squaring for integers y with |y| < 128, by logarithm for others."""
    size, whole = emit("abs", x), emit("eq", emit("floor", y), y)
    rest, square, product = emit("abs", y), x, 1.0
    # The bits of |y|, the lowest first; the rest is 0 if |y| < 128.
    for _ in range(7):
        half = emit("floor", emit("mul", 0.5, rest))
        odd = emit("eq", emit("sub", rest, emit("add", half, half)), 1.0)
        product = _select(odd, emit("mul", product, square), product)
        rest, square = half, emit("mul", square, square)
    product = _select(emit("lt", y, 0.0), emit("div", 1.0, product), product)
    value = _select(emit("eq", size, 1.0), 1.0, exp(emit("mul", y, log(size))))
    # A negative x needs an integer y, and an odd y makes the result negative.
    half = emit("mul", 0.5, y)
    value = _select(
        emit("lt", x, 0.0),
        _select(
            whole, _select(emit("eq", emit("floor", half), half), value, emit("neg", value)), nan
        ),
        value,
    )
    return _select(emit("and", whole, emit("eq", rest, 0.0)), product, value)


def fmod(x: Scalar, y: Scalar) -> Scalar:
    """Remainder with the sign of x: exact, because a fused multiply-add rounds only once."""
    size, period = emit("abs", x), emit("abs", y)
    ratio = emit("div", size, period)
    # |x| - floor(|x| / |y|) |y|
    left = emit("fma", emit("floor", ratio), emit("neg", period), size)
    # The ratio may have been rounded up.
    left = _select(emit("lt", left, 0.0), emit("add", left, period), left)
    left = _select(emit("lt", ratio, 2.0**53), left, nan)
    return emit("copysign", _select(emit("lt", size, period), size, left), x)


def hypot(x: Scalar, y: Scalar) -> Scalar:
    """Length of a vector; the components are scaled if their squares would
    overflow or underflow.
    """
    square = emit("add", emit("mul", x, x), emit("mul", y, y))
    far, near = emit("lt", 1e300, square), emit("lt", square, 1e-280)
    down, up = (_select(far, c, _select(near, 1.0 / c, 1.0)) for c in (2.0**-600, 2.0**600))
    a, b = emit("mul", x, down), emit("mul", y, down)
    return emit("mul", emit("sqrt", emit("add", emit("mul", a, a), emit("mul", b, b))), up)


def atan2(y: Scalar, x: Scalar) -> Scalar:
    """Angle of a point, from -pi to pi."""
    across, along = emit("abs", y), emit("abs", x)
    steep = emit("lt", along, across)
    # Reduce to 0 <= t <= 1, then to |t| <= 0.66 by atan t = pi/4 + atan((t - 1) / (t + 1)).
    low, high = _select(steep, along, across), _select(steep, across, along)
    t = emit("div", low, _select(emit("eq", high, 0.0), 1.0, high))
    t = _select(emit("and", emit("eq", low, inf), emit("eq", high, inf)), 1.0, t)
    beyond = emit("lt", 0.66, t)
    t = _select(beyond, emit("div", emit("sub", t, 1.0), emit("add", t, 1.0)), t)
    z = emit("mul", t, t)
    ratio = emit("div", emit("mul", z, _polynomial(z, _ATAN)), _polynomial(z, _ATAN_BELOW))
    angle = emit("add", emit("mul", t, ratio), t)
    angle = emit("add", angle, _select(beyond, 0.25 * pi, 0.0))
    # For |y| > |x| the ratio was inverted; for x < 0 the angle is beyond pi / 2.
    angle = _select(steep, emit("sub", 0.5 * pi, angle), angle)
    behind = emit("lt", emit("copysign", 1.0, x), 0.0)
    return emit("copysign", _select(behind, emit("sub", pi, angle), angle), y)


def _root(x: Scalar) -> Scalar:
    """``sqrt(1 - x^2)`` by factors, which keeps its digits near 1."""
    return emit("sqrt", emit("mul", emit("sub", 1.0, x), emit("add", 1.0, x)))


EXPANSIONS: dict[str, Callable[..., Scalar]] = {
    "sin": sin,
    "cos": cos,
    "tan": lambda x: emit("div", sin(x), cos(x)),
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
"""The function here for each function of the C library, by name."""
