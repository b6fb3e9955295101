"""The page's own files: forms, versions, policies."""

import base64
import gzip
import hashlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import brotli
import httpx
import pytest
from starlette.datastructures import Headers

from gsynopsis.errors import InputError
from gsynopsis.serve import assets
from gsynopsis.serve.app import make_app
from gsynopsis.serve.assets import best_coding, page_policy, read_site
from gsynopsis.serve.files import Root
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving

SCRIPT = "gsynopsis-viewer.js"


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    root = Root(tmp_path_factory.mktemp("none").resolve())
    app = make_app(root, viewer=FOLDER)
    with serving(app) as address, httpx.Client(base_url=address) as client:
        yield client


@pytest.mark.parametrize(
    ("header", "takes"),
    [
        ("gzip", True),
        ("gzip, deflate, br, zstd", True),
        ("GZIP;Q=0.5", True),
        ("x-gzip", True),
        ("*", True),
        ("identity;q=0.5, gzip;q=0.8", True),
        ("", False),
        ("br", False),
        ("identity", False),
        ("gzip;q=0", False),
        ("gzip; q=0.000", False),
        ("*;q=0", False),
        ("gzip;q=0, *", False),
        ("gzip;q=0.5, identity", False),
        ("gzip;q=nonsense", False),
        ("gzip;q=-1", False),
        ("gzip;q=1e9", False),
    ],
)
def test_a_client_gets_gzip_if_it_takes_it(header: str, takes: bool) -> None:
    assert (best_coding(header, ["gzip"]) == "gzip") == takes


@pytest.mark.parametrize(
    ("header", "coding"),
    [
        ("gzip, deflate, br, zstd", "br"),
        ("br", "br"),
        ("*", "br"),
        ("gzip", "gzip"),
        ("br;q=0.5, gzip", "gzip"),
        ("br;q=0, *", "gzip"),
        ("br;q=0.5, identity", ""),
        ("br;q=0.5, identity;q=0.8, gzip;q=0.9", "gzip"),
        ("zstd", ""),
        ("", ""),
    ],
)
def test_a_client_gets_the_form_that_it_likes_best(header: str, coding: str) -> None:
    assert best_coding(header) == coding


def test_the_script_comes_compressed_with_a_tag_of_its_own(client: httpx.Client) -> None:
    data = (FOLDER / SCRIPT).read_bytes()
    plain = client.get(f"/{SCRIPT}", headers={"Accept-Encoding": "identity"})
    packed = client.get(f"/{SCRIPT}", headers={"Accept-Encoding": "gzip", "Range": "bytes=0-9"})
    assert plain.content == packed.content == data
    assert packed.status_code == 200 and packed.headers["content-encoding"] == "gzip"
    assert int(packed.headers["content-length"]) < 0.45 * len(data)
    assert "content-encoding" not in plain.headers and "accept-ranges" not in plain.headers
    assert plain.headers["etag"] != packed.headers["etag"]
    for answer in (plain, packed):
        assert answer.headers["vary"] == "accept-encoding"
        same = {
            "Accept-Encoding": answer.headers.get("content-encoding", "identity"),
            "If-None-Match": answer.headers["etag"],
        }
        again = client.get(f"/{SCRIPT}", headers=same)
        assert (again.status_code, again.content) == (304, b"")
        other = {**same, "If-None-Match": '"x"', "If-Match": '"x"'}
        assert client.get(f"/{SCRIPT}", headers=other).status_code == 412


def test_the_page_names_the_script_by_its_bytes_and_both_are_never_stale(
    client: httpx.Client, tmp_path: Path
) -> None:
    def loaded(client: httpx.Client) -> tuple[str, httpx.Response]:
        page = client.get("/index.html")
        assert page.headers["cache-control"] == "no-cache"
        found = re.search(r'src="([^"]+)"', page.text)
        assert found is not None
        return found[1], client.get("/" + found[1])

    name, script = loaded(client)
    assert script.headers["cache-control"] == "public, max-age=31536000, immutable"
    # What it loads, workers too, it loads from beside itself: all of it has such an address.
    assert re.fullmatch(rf"v-[0-9a-f]{{16}}/{SCRIPT}", name)
    assert client.get(f"/{SCRIPT}").headers["cache-control"] == "no-cache"
    assert client.get(f"/v-0123456789abcdef/{SCRIPT}").status_code == 404
    for path in FOLDER.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    with (tmp_path / SCRIPT).open("a") as file:
        file.write("// newer")
    app = make_app(Root(tmp_path.resolve()), viewer=tmp_path)
    with serving(app) as address, httpx.Client(base_url=address) as upgraded:
        newer, script = loaded(upgraded)
    assert newer != name and script.text.endswith("// newer")


def test_the_policy_lets_the_pages_own_scripts_run_and_no_other(client: httpx.Client) -> None:
    page = client.get("/index.html")
    policy = page.headers["content-security-policy"]
    scripts = next(part for part in policy.split("; ") if part.startswith("script-src"))
    assert "'unsafe-inline'" not in scripts and "'unsafe-eval'" not in scripts
    inline = re.findall(r'<script type="module">(.*?)</script>', page.text, re.DOTALL)
    assert inline
    for code in inline:
        digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in scripts
    for word in ("base-uri 'none'", "form-action 'none'", "worker-src 'self' blob:"):
        assert word in policy


def test_line_ends_count_in_a_policy_as_a_browser_reads_them() -> None:
    one, other = (page_policy(f"<script>a{end}b</script>", "'self'") for end in ("\n", "\r\n"))
    assert one == other


def test_only_files_of_a_page_belong_to_it(tmp_path: Path) -> None:
    secret = tmp_path / "secret.js"
    secret.write_text("secret")
    viewer = tmp_path / "viewer"
    (viewer / "assets").mkdir(parents=True)
    (viewer / ".git").mkdir()
    for name in ("index.html", "assets/a.css", ".hidden.js", ".git/b.js", "notes.txt", "key.pem"):
        (viewer / name).write_text("x")
    (viewer / "link.js").symlink_to(secret)
    assert set(read_site(viewer).files) == {"index.html", "assets/a.css"}


def test_what_is_no_viewer_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"no index\.html"):
        read_site(tmp_path)
    (tmp_path / "index.html").write_text("x" * 100)
    monkeypatch.setattr(assets, "BYTES_MAX", 99)
    with pytest.raises(InputError, match="at most 99 bytes"):
        read_site(tmp_path)


def test_what_gains_nothing_is_not_compressed() -> None:
    noise = hashlib.shake_256(b"").digest(1000)
    assert not assets.asset_of(noise, ".wasm").packed
    assert not assets.asset_of(b"0" * 1000, ".png").packed
    assert gzip.decompress(assets.asset_of(b"0" * 1000, ".js").packed["gzip"]) == b"0" * 1000


def test_brotli_saves_a_tenth_and_may_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    data = b"".join(path.read_bytes() for path in sorted(FOLDER.glob("*.js")))
    both = assets.asset_of(data, ".js").packed
    assert brotli.decompress(both["br"]) == data
    assert len(both["br"]) < 0.9 * len(both["gzip"])
    monkeypatch.setitem(sys.modules, "brotli", None)
    assets.asset_of.cache_clear()
    asked = Headers({"accept-encoding": "br, gzip"})
    answer = assets.asset_of(data, ".js").answer(asked)
    assets.asset_of.cache_clear()
    assert answer.headers["content-encoding"] == "gzip" and answer.body == both["gzip"]
