"""The gallery and the viewer's page as our server gives them, with all their headers."""

import shutil
from pathlib import Path

import pytest

from benchmarks.viewer.browser import MISSING, pages, visit

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
INJECTED = """
globalThis.violations = [];
addEventListener("securitypolicyviolation", (event) => {
  violations.push(`${event.effectiveDirective} ${event.blockedURI}`);
});
"""
NAMES = "[...document.querySelectorAll('b')].map((e) => e.textContent)"
LOADED = """
performance.getEntriesByType("resource").map((e) => e.name).filter((name) => name.endsWith(".js"))
"""
INLINE = """(() => {
  const script = document.createElement("script");
  script.textContent = "globalThis.ran = true";
  document.body.append(script);
  return globalThis.ran ?? false;
})()"""


def test_a_gallery_leads_to_a_scene_that_runs_under_its_policy(small: Path, tmp_path: Path) -> None:
    for name in ("a#b?c%20d.gsyn", "plain.gsyn"):
        shutil.copy(small, tmp_path / name)
    steps = [
        {"name": "names", "script": NAMES},
        {"name": "before", "script": "violations"},
        {"shot": "gallery"},
        {"name": "go", "script": "void document.querySelector('li a').click()"},
        {"wait": "complete"},
        {"name": "violations", "script": "violations"},
        {"name": "scripts", "script": LOADED},
        {"name": "inline", "script": INLINE},
        {"name": "refused", "script": "violations"},
    ]
    with pages(tmp_path) as address:
        seen = visit(address, tmp_path, steps, (1280, 720), init=INJECTED)
    found = seen.results
    assert found["names"] == ["a#b?c%20d", "plain"]
    assert found["before"] == found["violations"] == []
    assert len(seen.times("complete")) == 1 and not seen.times("error")
    # Page and worker load one address, which a new version of the viewer does not have.
    assert found["scripts"] and all("/v-" in script for script in found["scripts"])
    assert found["inline"] is False
    assert found["refused"] == ["script-src-elem inline"]
