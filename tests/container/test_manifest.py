import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.robust.forge import taken
from gsynopsis.container import decode, encode
from gsynopsis.container.codecs import deflate
from gsynopsis.errors import ValueRangeError
from gsynopsis.records import LevelSet
from tests.level_sets import SINGLE, make_level_set

LEVELS = make_level_set(np.random.default_rng(0), SINGLE)
GOOD = '{"meta":{},"quality":[{}]}'


def with_notes(meta: dict[str, str], quality: dict[str, float]) -> LevelSet:
    level = replace(LEVELS.levels[0], quality=quality)
    return replace(LEVELS, meta=meta, levels=(level,))


def with_manifest(text: str | bytes) -> bytes:
    raw = text.encode() if isinstance(text, str) else text
    pieces = taken(encode(LEVELS))
    pieces.set_body(0, deflate(raw)[0], raw=len(raw), rows=len(raw))
    return pieces.data()


def test_notes_and_figures_come_back_as_they_were() -> None:
    meta = {"scene": "Fuchs 🦊", "licence": 'CC0 "x"\n', "": "\x1b"}
    quality = {"psnr_full": 30.123456789012345, "count": 7, "tiny": 5e-324}
    read = decode(encode(with_notes(meta, quality)), "x")
    assert read.meta == meta
    assert read.levels[0].quality == quality
    assert list(read.meta) == list(meta)


def test_a_name_that_is_no_utf8_is_written_with_question_marks() -> None:
    """As of a folder of photos whose name is Latin-1: a training ends with a file all the same."""
    read = decode(encode(with_notes({"scene": "caf\udce9"}, {})), "x")
    assert read.meta == {"scene": "caf?"}


def test_numpy_figures_are_written_as_numbers() -> None:
    data = encode(with_notes({}, {"psnr": np.float32(1.5), "n": np.float64(2)}), "raw")
    assert decode(data, "x").levels[0].quality == {"psnr": 1.5, "n": 2.0}
    assert encode(decode(data, "x"), "raw") == data


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_figure_that_is_not_finite_is_not_written(value: float) -> None:
    with pytest.raises(ValueRangeError, match=r"scene\.gsyn: manifest"):
        encode(with_notes({}, {"psnr": value}))


def test_notes_that_are_no_text_or_too_long_are_not_written() -> None:
    with pytest.raises(ValueRangeError, match="names to text"):
        encode(with_notes({"scene": 3}, {}))
    with pytest.raises(ValueRangeError, match="at most 65536"):
        encode(with_notes({"scene": "x" * 65536}, {}))
    longest = "x" * (65536 - len('{"meta":{"scene":""},"quality":[{}]}'))
    assert decode(encode(with_notes({"scene": longest}, {})), "x").meta["scene"] == longest


def test_a_plain_manifest_of_someone_else_reads() -> None:
    assert decode(with_manifest(GOOD), "x").meta == {}
    read = decode(with_manifest(' {"quality": [{"a": 3}], "meta": {"b": "c"}}\n'), "x")
    assert (read.meta, read.levels[0].quality) == ({"b": "c"}, {"a": 3.0})


BAD: dict[str, str | bytes] = {
    "no JSON": "{",
    "not UTF-8": b'{"meta":{"a":"\xff"},"quality":[{}]}',
    "no object": "[]",
    "a member is missing": '{"meta":{}}',
    "another member": '{"meta":{},"quality":[{}],"url":"x"}',
    "a name twice": '{"meta":{},"meta":{},"quality":[{}]}',
    "a name twice inside": '{"meta":{"a":"b","a":"b"},"quality":[{}]}',
    "meta is a list": '{"meta":[],"quality":[{}]}',
    "meta is a number": '{"meta":{"a":1},"quality":[{}]}',
    "too few levels": '{"meta":{},"quality":[]}',
    "too many levels": '{"meta":{},"quality":[{},{}]}',
    "quality is an object": '{"meta":{},"quality":{}}',
    "a figure is a list": '{"meta":{},"quality":[[]]}',
    "a figure is text": '{"meta":{},"quality":[{"a":"1"}]}',
    "a figure is true": '{"meta":{},"quality":[{"a":true}]}',
    "a figure is null": '{"meta":{},"quality":[{"a":null}]}',
    "NaN": '{"meta":{},"quality":[{"a":NaN}]}',
    "Infinity": '{"meta":{},"quality":[{"a":-Infinity}]}',
    "beyond float64": '{"meta":{},"quality":[{"a":1e999}]}',
    "an endless integer": '{"meta":{},"quality":[{"a":1' + "0" * 4000 + "}]}",
    "a longer integer": '{"meta":{},"quality":[{"a":1' + "0" * 9000 + "}]}",
    "UTF-16": GOOD.encode("utf-16"),
    "UTF-16 without a mark": GOOD.encode("utf-16-le"),
    "UTF-32": GOOD.encode("utf-32-be"),
    "a byte order mark": b"\xef\xbb\xbf" + GOOD.encode(),
    "half a surrogate pair": '{"meta":{"a":"\\ud800"},"quality":[{}]}',
    "half a surrogate pair in a name": '{"meta":{},"quality":[{"\\udfff":1}]}',
    "half a surrogate pair as bytes": b'{"meta":{"a":"\xed\xa0\x80"},"quality":[{}]}',
    "deep nesting": "[" * 60000,
    "long": json.dumps({"meta": ["x" * 1000], "quality": [{}]}),
}


@pytest.mark.parametrize("name", BAD)
def test_a_manifest_that_is_not_what_it_has_to_be_is_refused(name: str) -> None:
    with pytest.raises(ValueRangeError, match="x: manifest") as caught:
        decode(with_manifest(BAD[name]), "x")
    assert len(str(caught.value)) < 300
