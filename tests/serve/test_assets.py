"""The page's own files: versions, policies."""

import base64
import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from gsynopsis.errors import InputError
from gsynopsis.serve import assets
from gsynopsis.serve.app import make_app
from gsynopsis.serve.assets import page_policy, read_site
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


def test_the_script_comes_compressed_where_the_client_takes_that(client: httpx.Client) -> None:
    data = (FOLDER / SCRIPT).read_bytes()
    plain = client.get(f"/{SCRIPT}", headers={"Accept-Encoding": "identity"})
    packed = client.get(f"/{SCRIPT}", headers={"Accept-Encoding": "gzip", "Range": "bytes=0-9"})
    assert plain.content == packed.content == data
    assert packed.status_code == 200 and packed.headers["content-encoding"] == "gzip"
    assert int(packed.headers["content-length"]) < 0.45 * len(data)
    assert "content-encoding" not in plain.headers and "accept-ranges" not in plain.headers
    for answer in (plain, packed):
        assert answer.headers["vary"].lower() == "accept-encoding"
        again = client.get(f"/{SCRIPT}", headers={"If-None-Match": answer.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")


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
