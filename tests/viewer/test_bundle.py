"""The built viewer in the package: it is that of the sources, small, and clean."""

import gzip
import json
import re
import shutil
import subprocess
from pathlib import Path

import brotli
import pytest

from benchmarks.viewer.node import INSTALLED, SCRIPTS, SOURCES, npx
from gsynopsis.serve.page import FOLDER
from tests.viewer.node import run_node

MOST = 70_000
FIRST_MOST = 35 * 1024
WEBGPU = FOLDER / "gsynopsis-webgpu.js"
WEBGPU_MOST = 10_000
SHADER_TOKEN = r"#[^\n]*|[\w.]+|[-+*/<>=!&|%]?=|\+\+|--|<<|>>|&&|\|\||\S"
STYLE_TOKEN = r"[\w.#%-]+|\S"
needs_packages = pytest.mark.skipif(
    not INSTALLED, reason="viewer/node_modules is not there (npm ci): sources NOT checked"
)


def test_code_and_wasm_are_small() -> None:
    """Without what only those load who ask for WebGPU."""
    whole = b"".join(path.read_bytes() for path in SCRIPTS if path != WEBGPU)
    assert len(gzip.compress(whole, 9)) <= MOST


def test_webgpu_is_a_small_script_of_its_own() -> None:
    assert len(gzip.compress(WEBGPU.read_bytes(), 9)) <= WEBGPU_MOST
    viewer = (FOLDER / "gsynopsis-viewer.js").read_text(encoding="utf-8")
    assert "import(`./gsynopsis-webgpu.js`)" in viewer
    for path in SCRIPTS:
        assert ("@compute" in path.read_text(encoding="utf-8")) == (path == WEBGPU), path.name


def test_the_first_picture_waits_for_three_quarters_of_it() -> None:
    """On a line of 500 kbit/s each kilobyte is 16 ms of nothing to look at."""
    first = sum(
        len(brotli.compress((FOLDER / f"gsynopsis-{name}.js").read_bytes()))
        for name in ("viewer", "decoder")
    )
    assert first <= FIRST_MOST


def test_the_page_loads_nothing_from_elsewhere() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in FOLDER.iterdir())
    assert not re.findall(r"https?://[^\s\"'`]+", text)


@needs_packages
def test_the_built_viewer_is_that_of_the_sources(tmp_path: Path) -> None:
    for mode in ("page", "page-worker"):
        folder = ("--outDir", str(tmp_path / "built"), "--mode", mode, "--logLevel", "warn")
        npx("vite", "build", *folder)
    names = sorted(path.name for path in FOLDER.iterdir())
    assert names == sorted(path.name for path in (tmp_path / "built").iterdir())
    for name in names:
        fresh, kept = (tmp_path / "built" / name).read_bytes(), (FOLDER / name).read_bytes()
        assert fresh == kept, f"{name} is old: run `npm run build` in viewer/"


@needs_packages
def test_trimmed_shaders_and_styles_mean_the_same() -> None:
    found = json.loads(run_node("trim_literals.mjs", SOURCES))
    modules: dict[str, tuple[list[str], list[str]]] = found["modules"]
    assert {"src/render/shaders.ts", "src/render/survey.ts", "src/ui/style.ts"} <= set(modules)
    for name, (before, after) in modules.items():
        pattern = STYLE_TOKEN if "/ui/" in name else SHADER_TOKEN
        for old, new in zip(before, after, strict=True):
            assert tokens(old, pattern) == tokens(new, pattern), name
    assert sum(len(text) for _, after in modules.values() for text in after) < 16_500
    assert found["shader"] == [
        "a- -b+ +c;",
        "i++ + j;",
        "#if X\na=b;\n#endif\nc;",
        "#define N ",
        "\nx\n",
        " y ",
        "else if(a)return;",
    ]
    assert found["style"] == [" .a :not(.b),c>d{width:calc(100% - 2px)}"]


@needs_packages
def test_shortened_sources_are_as_right_as_those_with_whole_names() -> None:
    """A reference that kept the name of a member that lost it would be an error of types."""
    found = json.loads(run_node("shorten_privates.mjs", SOURCES))
    assert found["wrong"] == found["left"] == found["taken"] == []
    assert found["shortened"] > 300


def tokens(text: str, pattern: str) -> list[str]:
    """Words, numbers, signs and directives of a shader or a style sheet, without comments."""
    plain = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)
    return re.findall(pattern, re.sub(r";\s*}", "}", plain))


@needs_packages
def test_types_and_style_are_clean() -> None:
    """As of `tsc` and `eslint .`, which would both read all types."""
    found = json.loads(run_node("lint.mjs", SOURCES))
    assert found["types"] == found["style"] == []
    generated = len(list((SOURCES / "src").rglob("*.gen.ts")))
    assert found["styled"] == found["typed"] - generated > 100


@pytest.mark.skipif(
    shutil.which("clang") is None or shutil.which("wasm-ld") is None,
    reason="clang or lld is not installed: the WebAssembly kernel is NOT rebuilt",
)
def test_the_kernel_is_that_of_its_source() -> None:
    kept = (SOURCES / "src" / "decode" / "kernel" / "wasm.gen.ts").read_text()
    version = re.search(r"\(version ([0-9.]+)\)", kept)
    asked = subprocess.run(["clang", "--version"], capture_output=True, text=True, check=True)
    if version is None or version[1] not in asked.stdout:
        pytest.skip(f"another clang than {version and version[1]}: the kernel is NOT rebuilt")
    script = (SOURCES / "wasm" / "build").read_text()
    assert "kernel/wasm.gen.ts" in script
    made = subprocess.run(
        ["bash", str(SOURCES / "wasm" / "build"), "--print"], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    assert made.stdout == kept, "wasm.gen.ts is old: run viewer/wasm/build"
