"""The settings of an experiment: lists as a grid, distributions by samples, and seeds by a rule.

A setting gives a value to each key that varies. Keys are those of a scenario, with dots between
them, parcels by number or by name. A key of `cell` or of a parcel is both the truth and the host's
belief, unless the scenario has a belief of its own. `belief.KEY` sets the belief alone, and
`truth.KEY` the truth alone: the host keeps the value that the scenario has.
"""

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from itertools import pairwise, product
from numbers import Integral, Real
from typing import Any, SupportsInt, TypeGuard

import numpy as np

from mdms_model.errors import InputError
from mdms_model.scenario.file import set_key
from mdms_model.scenario.scenario import ScenarioError

Setting = Mapping[str, Any]
Tree = Mapping[str, Any]
SAMPLINGS = ("latin_hypercube", "sobol", "random")
MOST_RUNS = 1_000_000
#: `truth.KEY` is the truth alone.
TRUTH = "truth."
#: The keys of `cell` by which runs of a row differ from seed to seed.
ROW_CHANCES = ("motor_spread", "friction_spread")
_SCALES = ("uniform", "log_uniform", "integers")


@dataclass(frozen=True, slots=True)
class Distribution:
    """Values between two bounds, by samples. Raises `InputError` for bounds that are none.

    `kind` is `uniform`, `log_uniform` or `integers`; these include both bounds.
    """

    kind: str
    low: float
    high: float

    def __post_init__(self) -> None:
        bounds = self.low, self.high
        if self.kind not in _SCALES:
            raise InputError(f"{self.kind!r} is no distribution; there are {', '.join(_SCALES)}")
        if not all(is_number(bound) for bound in bounds) or not self.low < self.high:
            raise InputError(f"{self}: give two finite numbers, the lower one first")
        if self.kind == "log_uniform" and self.low <= 0.0:
            raise InputError(f"{self}: the lower bound must be above 0")
        if self.kind == "integers" and not all(float(bound).is_integer() for bound in bounds):
            raise InputError(f"{self}: give two whole numbers")

    def __str__(self) -> str:
        """As it is written in Python."""
        return f"{self.kind}({self.low!r}, {self.high!r})"

    def at(self, share: float) -> float:
        """The value below which a share [0 to 1] of all values lies."""
        if self.kind == "integers":
            values = self.high - self.low + 1.0
            return int(self.low + min(math.floor(share * values), values - 1.0))
        if self.kind == "log_uniform":
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + share * (self.high - self.low))


def uniform(low: float, high: float) -> Distribution:
    """All values between two bounds alike."""
    return Distribution("uniform", low, high)


def log_uniform(low: float, high: float) -> Distribution:
    """Values between two bounds above 0, their logarithms alike."""
    return Distribution("log_uniform", low, high)


def integers(low: int, high: int) -> Distribution:
    """All whole numbers from one to another alike, both included."""
    return Distribution("integers", low, high)


Values = Sequence[Any] | Distribution


def check_arguments(over: object, seed: object) -> None:
    """Raises `InputError` for keys and a seed of another type than they must have."""
    if not isinstance(over, Mapping):
        raise InputError(
            f"over is {over!r}, but must be a dict by keys of a scenario, such as "
            '{"cell.friction": [0.2, 0.3]}'
        )
    for key in over:
        if not isinstance(key, str):
            raise InputError(f"over: {key!r} must be text, a key of a scenario")
    if not _is_whole(seed):
        raise InputError(f"seed is {seed!r}, but must be a whole number")


def settings_of(
    over: Mapping[str, Values], samples: int, sampling: str, seed: int
) -> list[dict[str, Any]]:
    """All settings: each combination of the lists, with the same samples of the distributions.

    A setting is there once, however often it is drawn. Raises `InputError`.
    """
    if sampling not in SAMPLINGS:
        raise InputError(f"sampling is {sampling!r}, but must be one of {', '.join(SAMPLINGS)}")
    grid = {key: _listed(key, values) for key, values in over.items()}
    drawn = {key: each for key, each in over.items() if isinstance(each, Distribution)}
    lists = {key: values for key, values in grid.items() if values is not None}
    points = _points(len(drawn), samples, sampling, seed) if drawn else [()]
    count = len(points) * math.prod(map(len, lists.values()))
    if count > MOST_RUNS:
        raise InputError(f"over: {count:,} settings, but at most {MOST_RUNS:,}; leave some out")
    settings = []
    for combination in product(*lists.values()):
        listed = dict(zip(lists, combination, strict=True))
        for point in points:
            pairs = zip(drawn.items(), point, strict=True)
            sampled = {key: each.at(share) for (key, each), share in pairs}
            # In the order in which they were given: that of the table's columns.
            settings.append({key: (listed | sampled)[key] for key in over})
    # Whole numbers are drawn again and again.
    return list({repr(setting): setting for setting in settings}.values())


def _listed(key: str, values: Values) -> list[Any] | None:
    """The values of a key; None for a distribution. Raises `InputError`."""
    check_no_seed("over", key)
    if isinstance(values, Distribution):
        return None
    # An array of no axis has a length, but it raises.
    has_items = hasattr(values, "__len__") and getattr(values, "ndim", 1) != 0
    if isinstance(values, str | bytes | Mapping) or not has_items:
        raise InputError(
            f"over: {key} is {values!r}, but must be a list of values or a distribution"
        )
    if not len(values):
        raise InputError(f"over: {key} has no values; give it one or more, or leave it out")
    # Numbers of numpy become those of Python, as a scenario has them.
    listed = [each.tolist() if hasattr(each, "tolist") else each for each in values]
    for each in listed:
        if isinstance(each, float) and not math.isfinite(each):
            raise InputError(f"over: {key} has {each}, but must have finite numbers")
    return listed


def check_no_seed(name: str, key: str) -> None:
    """Raises `InputError` for the seed among the keys that vary, which each run has anyhow."""
    if key.removeprefix(TRUTH) == "run.seed":
        raise InputError(
            f"{name}: run.seed cannot vary by itself; `seeds` says which seeds are run"
        )


def _points(keys: int, samples: int, sampling: str, seed: int) -> list[Sequence[float]]:
    """Samples in the unit cube of so many keys. Raises `InputError`."""
    samples = check_count("samples", samples)
    if seed < 0:
        raise InputError(f"seed is {seed}, but must be 0 or more for samples to be drawn from it")
    if sampling == "sobol" and samples & (samples - 1):
        below = 1 << (samples.bit_length() - 1)
        raise InputError(
            f"samples is {samples}, but a sobol sequence is even only with a power of two; "
            f"take {below} or {2 * below}"
        )
    drawn: list[Sequence[float]] = _sampler(keys, sampling, seed)(samples).tolist()
    return drawn


def _sampler(keys: int, sampling: str, seed: int) -> Callable[[int], Any]:
    # It is an extra.
    from scipy.stats import qmc

    if sampling == "random":
        generator = np.random.default_rng(seed)
        return lambda samples: generator.random((samples, keys))
    engine: Any = qmc.Sobol if sampling == "sobol" else qmc.LatinHypercube
    random: Callable[[int], Any] = engine(keys, rng=seed).random
    return random


def check_count(name: str, count: object, least: int = 1) -> int:
    """A number of runs or samples. Raises `InputError` for any other."""
    if not _is_whole(count) or not least <= int(count) <= MOST_RUNS:
        raise InputError(
            f"{name} is {count!r}, but must be a whole number, {least} to {MOST_RUNS:,}"
        )
    return int(count)


def _is_whole(value: object) -> TypeGuard[SupportsInt]:
    """Whether a value is a whole number of Python or numpy, and no truth."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def run_seed(seed: int, replication: int) -> int:
    """The seed of a run: 48 bits of SHA-256 of `SEED/REPLICATION`, replications from 0.

    All settings of a sweep have the same seeds, and sweeps with another seed have others.
    """
    digest = hashlib.sha256(f"{seed}/{replication}".encode()).digest()
    return int.from_bytes(digest[:6])


def seeds_of(seeds: int | Sequence[int], seed: int) -> list[int]:
    """The seeds of the runs of each setting: so many by the rule, or those given."""
    if isinstance(seeds, Integral):
        return [run_seed(seed, each) for each in range(check_count("seeds", seeds))]
    listed = [*seeds] if isinstance(seeds, Sequence | np.ndarray) and np.ndim(seeds) else []
    if not listed or not all(_is_whole(each) and int(each) >= 0 for each in listed):
        raise InputError(f"seeds is {seeds!r}, but must be a number of runs, or a list of seeds")
    if len({*listed}) < len(listed):
        raise InputError(f"seeds is {seeds!r}: one stands there twice")
    return [int(each) for each in listed]


#: Keys that bring chance to a `row`.
_CHANCES = tuple(f"cell.{name}" for name in ROW_CHANCES)


def has_chance(base: Tree, over: Iterable[str]) -> bool:
    """Whether seeds make a difference: not in a `row` without spreads, unless `over` varies them.

    It may vary a table with them.
    """
    places = tuple(f"{key.removeprefix(TRUTH)}." for key in over)
    varies = any(f"{each}.".startswith(places) for each in ("run.fidelity", *_CHANCES))
    return varies or base["run"]["fidelity"] != "row" or any(map(base["cell"].get, ROW_CHANCES))


def check_chance(base: Tree, over: Iterable[str], seeds: Sequence[int]) -> None:
    """Raises `InputError` for more than one seed of a `row` without chance: all runs are alike."""
    if len(seeds) > 1 and not has_chance(base, over):
        raise InputError(
            f"seeds: {len(seeds)} are given, but run.fidelity is 'row', and this one has no "
            f"chance: all its runs are alike; give seeds = 1, or {' or '.join(_CHANCES)}"
        )


def tree_of(base: Tree, setting: Setting, seed: int) -> dict[str, Any]:
    """The tables of a scenario with a setting and a seed; `base` has all defaults written out.

    Raises `ScenarioError` for a key that leads nowhere, and for two keys of one value. Values are
    checked with the scenario.
    """
    check_apart(base, setting)
    tree = dict(deepcopy(base))
    # The truth comes last: then all that the host is told to believe is there.
    for key in sorted(setting, key=lambda each: each.startswith(TRUTH)):
        value = setting[key]
        path = numbered(tree, key.removeprefix(TRUTH))
        if key.startswith(TRUTH):
            _keep_belief(base, tree, path, setting)
        set_key(tree, path, value)
    set_key(tree, "run.seed", seed)
    return tree


def check_apart(base: Tree, keys: Iterable[str]) -> None:
    """Raises `ScenarioError` for two keys of which one sets the value of the other, or part of it.

    `truth.cell.friction` and `belief.friction` are two values.
    """
    places: list[tuple[list[str], str]] = []
    for key in keys:
        try:
            path = numbered(base, key.removeprefix(TRUTH))
        except ScenarioError:
            # Another key may give a parcel that name.
            path = key.removeprefix(TRUTH)
        # Without leading zeros.
        parts = [str(int(part)) if part.isdecimal() else part for part in path.split(".")]
        places.append((parts, key))
    # A part of a value comes right after the whole.
    places.sort()
    for (whole, first), (part, second) in pairwise(places):
        if part[: len(whole)] == whole:
            raise ScenarioError(f"{first} and {second} set the same value; give one")


def numbered(tree: Tree, key: str) -> str:
    """The key with the number of a parcel in place of its name."""
    head, _, rest = key.partition(".")
    name, dot, inner = rest.partition(".")
    if head != "parcel" or not dot or name.isdecimal():
        return key
    names = [parcel["name"] for parcel in tree.get("parcel", ())]
    if name not in names:
        raise ScenarioError(f"{key}: no parcel has that name; there are {', '.join(names)}")
    return f"parcel.{names.index(name)}.{inner}"


def _keep_belief(base: Tree, tree: dict[str, Any], path: str, setting: Setting) -> None:
    """Have the host go on believing the value of the scenario. Raises `ScenarioError`."""
    head, *inner = path.split(".")
    table: Any = base.get(head, {})
    where = ["belief"]
    if head == "parcel" and len(inner) > 1 and int(inner[0]) < len(table):
        table = table[int(inner[0])]
        where.append(table["name"])
        inner = inner[1:]
    elif head != "cell" or not inner:
        raise ScenarioError(
            f"{TRUTH}{path}: the host has no belief of its own of this key; "
            f"write {path}, or a key of cell or of a parcel, such as truth.cell.friction"
        )
    own = ".".join([*where, inner[0]])
    if own in setting or _has(tree, own):
        return
    if inner[0] not in table:
        raise ScenarioError(
            f"{TRUTH}{path}: the scenario has no value of this key for the host to believe; "
            f"give it one, or {own}"
        )
    set_key(tree, own, deepcopy(table[inner[0]]))


def _has(tree: Any, path: str) -> bool:
    for part in path.split("."):
        if not isinstance(tree, Mapping) or part not in tree:
            return False
        tree = tree[part]
    return True


def meanings_of(base: Tree, keys: Sequence[str]) -> dict[str, str]:
    """Whether each key that varies is the truth, the host's belief, or both.

    The meaning is empty where truth and belief are no two things: without a host, of other keys
    than those of `cell` and of parcels, and beside a belief that varies as a whole table.
    """
    # Only firmware has a host.
    if base["run"]["fidelity"] != "firmware" and not {"run", "run.fidelity"} & {*keys}:
        return dict.fromkeys(keys, "")
    return {key: _meaning(base, key, keys) for key in keys}


def _meaning(base: Tree, key: str, keys: Sequence[str]) -> str:
    if key.startswith(TRUTH):
        return "truth alone"
    if key.startswith("belief."):
        return "belief alone"
    head, *inner = key.split(".")
    told: Any = base.get("belief", {})
    own = "belief"
    if head == "parcel" and len(inner) > 1:
        named = {str(number): each["name"] for number, each in enumerate(base.get("parcel", ()))}
        name = named.get(inner[0], inner[0])
        told, own, inner = told.get(name, {}), f"{own}.{name}", inner[1:]
    elif head != "cell" or not inner:
        return ""
    if own in keys or "belief" in keys:
        return ""
    own = f"{own}.{inner[0]}"
    # A host that does not know of a parcel believes nothing of it.
    apart = inner[0] in told or not told.get("known", True)
    if apart or any(each == own or each.startswith(f"{own}.") for each in keys):
        return "truth alone"
    return "truth and belief"


def is_number(value: object) -> bool:
    """Whether a value is a finite number, and no truth."""
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
