"""The viewer's estimates and views against the Python ones they are ported from."""

import json
from base64 import b64encode
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsynopsis.container import Assembler
from gsynopsis.stream import lookahead as viewed
from gsynopsis.stream.catalog import Catalog, Item, Key, catalog_of
from gsynopsis.stream.coalesce import coalesce
from gsynopsis.stream.fetch import Sample
from gsynopsis.stream.lookahead import viewed_quality
from gsynopsis.stream.policy import State, estimate, missing
from gsynopsis.stream.views import ViewPose, covered, extrapolate
from tests.level_sets import Shape
from tests.stream.cases import FILE, RATE, written
from tests.stream.scenes import FREE, SHAPE, hand_made, large_states, small_file, state_of
from tests.viewer.node import needs_node, run_node

pytestmark = needs_node


def asked(folder: Path, **request: Any) -> dict[str, Any]:
    """What the viewer's functions answer, see policy.mjs."""
    path = folder / "request.json"
    path.write_text(json.dumps(request))
    return json.loads(run_node("policy.mjs", path))


def sent(eye: ViewPose) -> dict[str, Any]:
    """A camera as the viewer knows it."""
    position = -eye.w2c[:3, :3].T @ eye.w2c[:3, 3]
    w2c = eye.w2c[:3].ravel().tolist()
    return {"w2c": w2c, "position": position.tolist(), "right": eye.right, "up": eye.up}


@pytest.mark.parametrize("shape", [SHAPE, FREE], ids=["own networks", "inherited"])
def test_the_catalog_of_a_file_is_that_of_python(shape: Shape, tmp_path: Path) -> None:
    path, data = tmp_path / "small.gsyn", small_file(shape=shape)
    path.write_bytes(data)
    (found,) = asked(tmp_path, files=[str(path)])["catalogs"]
    assembler = Assembler(data[:16384], "small")
    assembler.add_level(data)
    catalog = catalog_of(assembler)
    assert len(found) == len(catalog.items)
    for sent, (key, item) in zip(found, catalog.items.items(), strict=True):
        assert (sent["level"], sent["block"]) == key
        assert (sent["start"], sent["size"], sent["slots"]) == (item.start, item.size, item.slots)
        assert sent["region"] == item.region.tolist()
        assert {list(catalog.items)[number] for number in sent["needs"]} == set(item.needs)
        assert len(sent["needs"]) == len(item.needs)


def test_an_order_stands_for_nine_times_what_it_took_to_find(tmp_path: Path) -> None:
    path, data = tmp_path / "small.gsyn", small_file()
    path.write_bytes(data)
    (requests,) = asked(tmp_path, asked=[str(path)])["orders"]
    assembler = Assembler(data[:16384], "small")
    assembler.add_level(data)
    known = {(0, -1)}
    for request in requests:
        for item in map(tuple, request["items"]):
            assert item not in known
            assert {tuple(key) for key in catalog_of(assembler).items[Key(*item)].needs} <= known
            known.add(item)
    assert known == {tuple(key) for key in catalog_of(assembler).items}
    # The clock ticks at each look: one where the order stands, another after one was found.
    ticks = [request["ticks"] for request in requests]
    assert len(ticks) > 40
    assert ticks == ([2, *[1] * 9] * len(ticks))[: len(ticks)]


def test_throughput_and_what_boxes_cover_are_those_of_the_policies(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    runs = [
        [(int(rng.integers(1, 10**6)), float(rng.uniform(0.05, 3))) for _ in range(count)]
        for count in (0, 1, 7, 40)
    ]
    low = rng.uniform(-5, 4, (30, 3))
    high = low + rng.uniform(0.01, 3, (30, 3))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    w2c = np.eye(4)
    w2c[:3, :3], w2c[:3, 3] = turn * np.sign(np.linalg.det(turn)), rng.uniform(-1, 1, 3)
    request = {
        "samples": [[{"amount": a, "seconds": s} for a, s in run] for run in runs],
        "boxes": np.hstack([low, high]).tolist(),
        "eye": sent(ViewPose(w2c, 0.7, 0.5)),
    }
    found = asked(tmp_path, **request)
    for run, rate in zip(runs, found["rates"], strict=True):
        samples = [Sample(amount, seconds) for amount, seconds in run]
        assert rate == pytest.approx(estimate(samples), rel=1e-9)
    expected = covered(low, high, ViewPose(w2c, 0.7, 0.5))
    assert expected.max() > 20 * expected.min() > 0
    assert np.allclose(found["shares"], expected, rtol=1e-9, atol=1e-12)


def test_a_steady_motion_goes_on_as_in_python(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    eyes = []
    for _ in range(2):
        turn = np.linalg.qr(np.eye(3) + 0.2 * rng.standard_normal((3, 3)))[0]
        w2c = np.eye(4)
        w2c[:3, :3], w2c[:3, 3] = turn * np.sign(np.linalg.det(turn)), rng.uniform(-1, 1, 3)
        eyes.append(ViewPose(w2c, 0.7, 0.5))
    times = [0.0, 0.1, 1.0, 4.0]
    found = asked(tmp_path, motion=[*map(sent, eyes), 0.25, times])["ahead"]
    for eye, expected in zip(found, extrapolate(eyes[0], eyes[1], 0.25, times), strict=True):
        w2c = np.reshape(eye["w2c"], (3, 4))
        assert np.allclose(w2c, expected.w2c[:3], atol=1e-9)
        assert np.allclose(eye["position"], -w2c[:, :3].T @ w2c[:, 3], atol=1e-9)


def test_ours_answers_the_cases_of_the_policies(tmp_path: Path) -> None:
    """Those of tests/stream, made by hand and by trying all orders."""
    cases = json.loads(FILE.read_text())
    answers = asked(tmp_path, cases=cases, rate=RATE)["answers"]
    for case, answer in zip(cases, answers, strict=True):
        assert answer["choice"] in case["good"], case["name"]
        for value, (_, expected) in zip(answer["values"], case["orders"], strict=True):
            assert value == pytest.approx(expected, rel=1e-6)
        rest = [i["key"] for i in case["state"]["items"] if i["key"] not in case["state"]["held"]]
        assert sorted(answer["played"]) == sorted(rest), "all is asked for once, needs first"
    assert sum(len(case["orders"]) for case in cases) > 20


def any_states(count: int) -> list[tuple[State, list[Key]]]:
    """States of random sizes, shares and holdings, each with goals in a random order.

    None has a limit of what the device can draw, which the viewer keeps by rows that it evicts.
    """
    rng = np.random.default_rng(9)
    found = []
    for _ in range(count):
        sizes = {(k, leaf): int(rng.integers(1, 5000)) for k in (1, 2, 3) for leaf in range(5)}
        catalog = hand_made(sizes, (0.1, 1e-2, 1e-3, 1e-5), 5, rng.integers(0, 900, 4).tolist())
        keys = list(catalog.items)
        share = rng.dirichlet(np.ones(5) * 0.5, 4).tolist()
        held = missing(state_of(catalog, share, held=()), keys)[: int(rng.integers(1, len(keys)))]
        state = state_of(catalog, share, float(rng.uniform(10, 1e5)), held)
        found.append((state, [keys[i] for i in rng.permutation(len(keys))]))
    return found


def answers_to(states: list[tuple[State, list[Key]]], folder: Path) -> list[dict[str, Any]]:
    """What the viewer makes of them."""
    requests = [
        {
            "content": written(state),
            "goals": goals,
            "order": missing(state, goals),
            "rate": estimate(state.samples),
        }
        for state, goals in states
    ]
    return asked(folder, states=requests)["lists"]


def test_parts_of_ours_are_those_of_python_on_any_state(tmp_path: Path) -> None:
    states = any_states(60)
    for (state, goals), answer in zip(states, answers_to(states, tmp_path), strict=True):
        lacks = missing(state, goals)
        assert answer["missing"] == [list(key) for key in lacks]
        value = viewed_quality(state, lacks, estimate(state.samples))
        assert answer["value"] == pytest.approx(value, rel=1e-9)


def test_sorted_orders_and_choices_are_those_of_python_on_any_state(tmp_path: Path) -> None:
    states = any_states(200)
    rng = np.random.default_rng(10)
    for number, (state, goals) in enumerate(states[1::2]):
        # Every second file says what its blocks add.
        table = np.full((4, state.catalog.leaves), 1e-5)
        for level in (2, 1, 0):
            gain = rng.uniform(0, 1, state.catalog.leaves) ** 4 * 10.0 ** (-level - 1)
            table[level] = table[level + 1] + gain
        catalog = replace(state.catalog, table=table)
        states[2 * number + 1] = (replace(state, catalog=catalog), goals)
    for (state, _), answer in zip(states, answers_to(states, tmp_path), strict=True):
        expected = [[list(key) for key in order] for order in viewed.sorted_orders(state)]
        assert answer["sorted"] == expected
        choice = viewed.ours(state)
        assert answer["ours"] == (None if choice is None else list(choice))


def test_choices_in_a_large_file_are_those_of_python(tmp_path: Path) -> None:
    states = [replace(state, budget=0) for state in large_states(6)]
    goals = [(state, []) for state in states]
    for state, answer in zip(states, answers_to(goals, tmp_path), strict=True):
        choice = viewed.ours(state)
        assert answer["ours"] == (None if choice is None else list(choice))


def runs_of(cases: list[tuple[list[tuple[int, int]], int, set[int], float]]) -> list[list[int]]:
    """What Python asks for as one, as numbers of items."""
    found = []
    for spans, number, known, rate in cases:
        items = {
            Key(1, n): Item(Key(1, n), start, start + size) for n, (start, size) in enumerate(spans)
        }
        catalog = Catalog(items, np.ones(2), np.zeros((1, 3)), np.ones((1, 3)))
        run = coalesce(catalog, Key(1, number), {Key(1, n) for n in known}, rate)
        found.append([key.block for key in run])
    return found


def test_what_is_asked_for_as_one_is_as_in_python(tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    # One that is too large behind takes no room from those before.
    cases = [([(0, 400), (400, 500), (900, 100), (1000, 9000)], 2, {0}, 20_000.0)]
    for _ in range(300):
        sizes = rng.integers(0, 1500, 14) * (rng.random(14) < 0.9)
        gaps = rng.integers(1, 50, 14) * (rng.random(14) < 0.1)
        stops = np.cumsum(sizes + gaps)
        number = int(rng.integers(14))
        known = {int(n) for n in np.flatnonzero(rng.random(14) < 0.2)} - {number}
        spans = list(zip((stops - sizes).tolist(), sizes.tolist(), strict=True))
        cases.append((spans, number, known, float(10 ** rng.uniform(3, 5.5))))
    requests = [
        {
            "items": [{"start": start, "size": size} for start, size in spans],
            "number": number,
            "known": sorted(known),
            "rate": rate,
        }
        for spans, number, known, rate in cases
    ]
    expected = runs_of(cases)
    assert expected[0] == [1, 2]
    backward = [run for run, case in zip(expected, cases, strict=True) if run[0] < case[1]]
    assert len(backward) > 50
    assert asked(tmp_path, runs=requests)["runs"] == expected


def test_what_blocks_add_is_read_from_the_manifest_if_it_fits_the_file(tmp_path: Path) -> None:
    def text(numbers: list[int]) -> str:
        return b64encode(bytes(numbers)).decode()

    good, blocks = text([0, 255, 251, 135, 1]), [2, 3]
    notes = [good, text([1] * 4), text([1] * 6), "", "no base64!", good[:-2]]
    found = asked(tmp_path, gains=[{"text": note, "blocks": blocks} for note in notes])["gains"]
    first, second = found[0]
    assert np.allclose(first, [0, 1])
    # Four numbers to a decibel, down from 0 dB.
    assert np.allclose(second, [10**-0.1, 1e-3, 10 ** (-63.5 / 10)])
    assert found[1:] == [None] * 5
