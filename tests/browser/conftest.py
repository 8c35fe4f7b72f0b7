"""A real Chromium without a window, and a case with hostile names to look at.

Most visits are marked slow; the default run makes three. All are skipped where no Chromium is installed.
"""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

HOSTILE = "<script>alert(1)</script> & \"q\" 'q' <img src=x onerror=alert(2)>"
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


@pytest.fixture(scope="session")
def chromium():
    playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
    program = os.environ.get("GYROTRACK_CHROMIUM") or next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip("no Chromium is installed (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


class Visit:
    """One visit to a page, with everything that must not happen in it."""

    def __init__(self, browser, width=1280):
        self.context = browser.new_context(viewport={"width": width, "height": 1000}, accept_downloads=True)
        self.page = self.context.new_page()
        self.faults, self.dialogs, self.hosts = [], [], set()
        self.page.on("pageerror", lambda e: self.faults.append(str(e)))
        self.page.on("console", self._console)
        self.page.on("dialog", self._dialog)
        self.page.on("request", lambda r: self.hosts.add(r.url.split("/")[2] if "//" in r.url else ""))

    def _console(self, message):
        # an answer of 400 is how a request that cannot be fulfilled is answered; the page shows it
        if message.type == "error" and "status of 400" not in message.text:
            self.faults.append(message.text)

    def _dialog(self, dialog):
        self.dialogs.append(dialog.message)
        dialog.dismiss()

    def close(self, hosts):
        self.context.close()
        assert not self.faults
        assert not self.dialogs
        assert self.hosts <= set(hosts)


def accessibility(page, *rules):
    """Return what axe-core has against a page, by these rules only if any are given."""
    source = pytest.importorskip("axe_playwright_python.base").AXE_SCRIPT
    # put into the page by the driver, not by the page, whose policy allows no other script
    page.context.new_cdp_session(page).send("Page.setBypassCSP", {"enabled": True})
    page.evaluate(source)
    options = {"resultTypes": ["violations"]} | ({"runOnly": list(rules)} if rules else {})
    found = page.evaluate("(options) => axe.run(document, options)", options)
    return [(v["id"], [n["target"] for n in v["nodes"]]) for v in found["violations"]]


@pytest.fixture(scope="session")
def case(tmp_path_factory):
    """A case of which the reduced model misses the casing's quadratic drag, with 0.5 s of film beside it."""
    import av

    from gyrotrack import read_case, write_case
    from gyrotrack.apps.cli._app import run
    from gyrotrack.io._records import Placement
    from gyrotrack.tracking._extract import extract

    folder = tmp_path_factory.mktemp("case")
    options = "--duration 60 --casing-fps 60 --rotor-fps 250 --window 3 --window 25 --window 52 --sigma 5e-4"
    words = f"--add casing.air.quadratic --set casing.air.quadratic.k=3e-10 --seed 1 {options} --json -q"
    assert run(["simulate", "-o", str(folder / "plain.h5"), *words.split()]) == 0
    film = folder / "casing.mp4"
    clip = Path(__file__).parents[2] / "sample_clips" / "casing.mp4"
    with av.open(str(clip)) as source, av.open(str(film), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for n, packet in enumerate(source.demux(video=0)):
            if n < 130 and packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    recording = extract(film, capture_fps=260.0)
    marker = next(iter(recording.markers.values()))
    recording = replace(
        recording, warnings=(HOSTILE,), markers={**recording.markers, "x": replace(marker, name="x")}
    )
    placement = Placement("casing", 10.0, 1e-4, 1.0, 0.0, 0.0, True, HOSTILE)
    plain = read_case(folder / "plain.h5")
    whole = replace(
        plain,
        label=HOSTILE,
        surface=HOSTILE,
        recordings={"casing": recording},
        placements={"casing": placement},
    )
    path = folder / "case.h5"
    write_case(path, whole, command="test", settings={})
    assert np.isfinite(recording.centre).any()
    return path
