"""The motion of one phase in closed form: x'' = alpha + beta x + gamma x'.

While no wheel changes its contact and no support comes or goes, the parcel is a mass on a spring
(sliding wheels, eq 6) with a damper (rolling wheels, eq 11). Everything is counted from the phase's
start, by its speed and acceleration there, so that weak springs lose no digits. beta < 0 is a
spring, beta > 0 pushes away; gamma <= 0.
"""

import math

from mdms_model.compiled import compiled

SERIES_BELOW = 0.5
CANCELS_BELOW = 0.05
NO_SPRING = 1e-30


@compiled
def basis(beta: float, gamma: float, time_s: float) -> tuple[float, float]:
    """The response S to a unit acceleration, S'' = gamma S' + beta S, and its integral.

    S(0) = 0, S'(0) = 1; S' follows as 1 + gamma S + beta integral.
    """
    if gamma == 0.0 and beta < 0.0:
        return basis_spring(beta, time_s)
    stiff = abs(beta) * time_s * time_s
    if abs(gamma) * time_s + stiff < SERIES_BELOW:
        return basis_series(beta, gamma, time_s)
    if stiff < NO_SPRING:
        s = math.expm1(gamma * time_s) / gamma
        return s, (s - time_s) / gamma
    sigma = gamma / 2
    split = sigma * sigma + beta
    if split < 0.0:
        omega = math.sqrt(-split)
        decay = math.exp(sigma * time_s)
        s = decay * math.sin(omega * time_s) / omega
        c = decay * math.cos(omega * time_s) - sigma * s
        return s, (c - 1.0) / beta
    root = math.sqrt(split)
    fast = sigma - root
    slow = -beta / fast
    decay = math.exp(fast * time_s)
    if root == 0.0:
        s = time_s * decay
    else:
        s = -math.exp(slow * time_s) * math.expm1(-2.0 * root * time_s) / (2.0 * root)
    if stiff > CANCELS_BELOW:
        return s, (decay - fast * s - 1.0) / beta
    parts = math.expm1(slow * time_s) / slow - math.expm1(fast * time_s) / fast
    return s, parts / (2.0 * root)


@compiled
def basis_spring(beta: float, time_s: float) -> tuple[float, float]:
    """`basis` where every wheel slides: nothing but a spring."""
    omega = math.sqrt(-beta)
    sine, cosine = math.sin(omega * time_s / 2), math.cos(omega * time_s / 2)
    return 2.0 * sine * cosine / omega, -2.0 * sine * sine / beta


@compiled
def basis_series(beta: float, gamma: float, time_s: float) -> tuple[float, float]:
    """`basis` as its Taylor series, for short times."""
    before, term = 0.0, time_s
    s, integral = time_s, time_s * time_s / 2
    for k in range(2, 24):
        before, term = term, (gamma * term + beta * time_s * before / (k - 1)) * time_s / k
        s += term
        integral += term * time_s / (k + 1)
        if abs(term) + abs(before) < 1e-18 * time_s:
            break
    return s, integral


@compiled
def advance(
    beta: float, gamma: float, speed: float, acceleration: float, time_s: float
) -> tuple[float, float, float]:
    """Change of place, change of speed, and the acceleration, `time_s` after a phase's start."""
    s, integral = basis(beta, gamma, time_s)
    return (
        speed * (s - gamma * integral) + acceleration * integral,
        speed * beta * integral + acceleration * s,
        acceleration * (1.0 + gamma * s + beta * integral) + speed * beta * s,
    )


@compiled
def first_zero(beta: float, gamma: float, value: float, slope: float) -> float:
    """When a solution of w'' = gamma w' + beta w is zero for the first time after 0; inf: never."""
    sigma = gamma / 2
    split = sigma * sigma + beta
    across = sigma * value - slope
    if split < 0.0:
        omega = math.sqrt(-split)
        if value == 0.0:
            return math.pi / omega
        # Divided, not multiplied by the value: the product of two small numbers could vanish.
        return math.atan2(omega, across / value) / omega
    if value == 0.0 or across == 0.0 or (value > 0.0) != (across > 0.0):
        return math.inf
    root, reach = math.sqrt(split), value / across
    if root * reach >= 1.0:
        return math.inf
    return math.atanh(root * reach) / root if root > 0.0 else reach


@compiled
def half_period(beta: float, gamma: float) -> float:
    """Time between two zeros of any solution; inf where it does not swing."""
    split = gamma * gamma / 4 + beta
    return math.pi / math.sqrt(-split) if split < 0.0 else math.inf
