"""Hand-made states of the streaming policy with their answers, for Python and for the browser.

`python -m tests.stream.cases` writes `cases.json`, which the tests of both sides read. What a
policy may answer comes from all orders being tried, not from a policy; sums of quality come from
`test_policy.watched`, an account of its own.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from gsynopsis.stream.catalog import SHARED, Catalog, Item, Key
from gsynopsis.stream.fetch import Sample
from gsynopsis.stream.policy import State
from tests.stream.scenes import BASE, CASES, ERRORS, EVEN, brute_force, hand_made, state_of

FILE = Path(__file__).parent / "cases.json"
GOOD = 0.99
"""An answer is good if an order that begins with it reaches this share of the best order."""
ORDERS = 12
"""Of each state so many orders are kept with their quality."""
RATE = 1000.0


def cases() -> list[dict[str, Any]]:
    """All of them."""
    found = []
    for name, (shares, sizes, shared) in CASES.items():
        catalog = hand_made(sizes, ERRORS, 3, shared)
        seen = [leaf for leaf in range(3) if np.array(shares)[:, leaf].any()][:2]
        given = [Key(k, leaf) for k in (1, 2) for leaf in range(3) if leaf not in seen]
        state = state_of(catalog, shares, RATE / 0.9, (BASE, Key(1, SHARED), *given))
        best, orders = brute_force(state, RATE)
        found.append(_case(name, state, {o[0] for value, o in orders if value >= GOOD * best}))
    catalog = hand_made(EVEN, ERRORS, 3, (500, 100, 100))
    every_shared = (BASE, Key(1, SHARED), Key(2, SHARED))
    for name, shares in (
        ("all orders, at rest", [[0.6, 0.3, 0.1]] * 4),
        ("all orders, turning", [[1.0, 0, 0], [0.5, 0.5, 0], *[[0, 0.2, 0.8]] * 3]),
    ):
        state = state_of(catalog, shares, RATE / 0.9, every_shared)
        best, orders = brute_force(state, RATE)
        case = _case(name, state, {o[0] for value, o in orders if value >= GOOD * best})
        usable = [[[list(key) for key in o], value] for value, o in orders if _usable(state, o)]
        case["orders"] = usable[:: len(usable) // ORDERS]
        found.append(case)
    turning = [[1.0, 0, 0], *[[0, 1.0, 0]] * 9]
    shared = (BASE, Key(1, SHARED))
    for name, shares, held, answer in (
        ("at the start", turning, (BASE,), Key(1, SHARED)),
        ("turning", turning, shared, Key(1, 1)),
        ("at rest", [[1.0, 0, 0]] * 9, shared, Key(1, 0)),
        ("turning, the present is there", turning, (*shared, Key(1, 0)), Key(1, 1)),
    ):
        state = state_of(catalog, shares, 500, held)
        found.append(_case(name, state, {answer}))
    # The present's next block takes four and a half seconds: it is of use in the fifth only.
    catalog = hand_made({**EVEN, (1, 0): 4500}, ERRORS, 3, (500, 100, 100))
    for name, turn, answer in (
        ("what is seen after the horizon does not count", 5, Key(1, 0)),
        ("what is seen at the horizon counts", 4, Key(1, 1)),
    ):
        shares = [*[[1.0, 0, 0]] * turn, *[[0, 1.0, 0]] * (11 - turn)]
        found.append(_case(name, state_of(catalog, shares, RATE / 0.9, shared), {answer}))
    return found


def _case(name: str, state: State, good: set[Key]) -> dict[str, Any]:
    keys = [list(key) for key in sorted(good)]
    return {"name": name, "state": written(state), "good": keys, "orders": []}


def _usable(state: State, order: tuple[Key, ...]) -> bool:
    known = set(state.held)
    for key in order:
        if not known.issuperset(state.catalog.items[key].needs):
            return False
        known.add(key)
    return True


def written(state: State) -> dict[str, Any]:
    """A state as JSON."""
    items = [
        {
            "key": list(item.key),
            "size": item.size,
            "needs": [list(need) for need in item.needs],
            "region": item.region.tolist(),
            "slots": item.slots,
        }
        for item in state.catalog.items.values()
    ]
    table = state.catalog.table
    measured = {} if table is None else {"table": table.tolist()}
    return {
        **measured,
        "items": items,
        "errors": state.catalog.errors.tolist(),
        "leaves": state.catalog.leaves,
        "held": [list(key) for key in sorted(state.held)],
        "samples": [{"amount": s.amount, "seconds": s.seconds} for s in state.samples],
        "shares": state.shares.tolist(),
        "moments": state.moments.tolist(),
    }


def read(content: dict[str, Any], budget: int = 0) -> State:
    """A state from its JSON."""
    items: dict[Key, Item] = {}
    start = 0
    for entry in content["items"]:
        key, stop = Key(*entry["key"]), start + entry["size"]
        needs = tuple(Key(*need) for need in entry["needs"])
        region = np.array(entry["region"], np.int64)
        items[key] = Item(key, start, stop, needs, region, entry["slots"])
        start = stop
    corners = np.arange(3.0 * content["leaves"]).reshape(-1, 3)
    catalog = Catalog(items, np.array(content["errors"]), corners, corners + 1)
    held = frozenset(Key(*key) for key in content["held"])
    samples = tuple(Sample(**sample) for sample in content["samples"])
    shares, moments = np.array(content["shares"]), np.array(content["moments"])
    return State(catalog, held, frozenset(), samples, shares, moments, budget)


def main() -> None:
    FILE.write_text(json.dumps(cases()) + "\n")
    print(f"wrote {FILE}")


if __name__ == "__main__":
    main()
