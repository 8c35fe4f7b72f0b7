"""Files that were changed at random are read or refused in one sentence: every kind of file, a fixed number of changes.

The seeds are small files of each kind, and what earlier searches have found. `pytest -m slow --hypothesis-profile
searching` looks for new ones.
"""

import json
import zlib
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fitting import FittingError, Ledger, read_effects
from gyrotrack import GyrotrackError, OutputError, import_body
from gyrotrack.apps.batch._experiments import read_manifest, read_study
from gyrotrack.apps.batch._steps import Journal
from gyrotrack.apps.workbench._project import STATE_FILE, Project
from gyrotrack.io._atomic import CheckpointFile, checkpoint_path
from gyrotrack.tracking._film_parts import frames_done
from gyrotrack.tracking._profile import load

pytestmark = pytest.mark.slow
BUDGET = settings(
    max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)

# what replaces a part of a file
TOKENS = (
    b"", b"\0", b"\xff\xfe", b"\n", b"\r", b'"', b",", b"{", b"[" * 2000, b"]", b"null", b"true", b"NaN", b"-0",
    b"1e400", b"-1e-320", b"1e305", b"1" + b"0" * 400, b"9" * 5000, b"\\ud800", b"fabc", b"\xc3\x28", b"'", b"#",
)  # fmt: skip


@st.composite
def changes(draw):
    """A function that changes some bytes."""
    kinds = st.sampled_from(("replace", "cut", "double", "flip"))
    steps = draw(
        st.lists(
            st.tuples(
                kinds, st.floats(0, 1), st.integers(0, 40), st.sampled_from(TOKENS), st.integers(1, 255)
            ),
            min_size=1,
            max_size=4,
        )
    )

    def changed(content):
        for kind, where, length, token, bits in steps:
            a = int(where * len(content))
            b = min(a + length, len(content))
            if kind == "replace":
                content = content[:a] + token + content[b:]
            elif kind == "cut":
                content = content[:a] + content[b:]
            elif kind == "double":
                content = content[:b] + content[a:]
            elif a < len(content):
                content = content[:a] + bytes([content[a] ^ bits]) + content[a + 1 :]
        return content

    return changed


def _table(separator, header):
    rows = [separator.join((f"{0.01 * k:.4f}", f"{0.1 * k - 1e-4 * k * k:.5f}")) for k in range(40)]
    return "\n".join([separator.join(header), *rows, ""]).encode()


_COLUMNS = {"t": [0.01 * k for k in range(40)], "angle": [0.1 * k for k in range(40)]}
_ENTRY = {
    "fit_id": "f1",
    "model": ["casing.air.linear"],
    "parameters": {
        "casing.air.linear.b2": {"value": 1e-7, "stderr": 1e-9, "unit": "N m s", "at_bound": False}
    },
    "digests": ["0" * 64],
    "verdict": "x",
    "ranges": {"a": [0, 1]},
    "variables": ["casing.air.linear.b2"],
    "covariance": [[1e-18]],
    "prior": {"source": "s", "names": ["a"], "mean": [1.0], "covariance": [[1.0]]},
    "own_effects": [{"name": "lab.x", "joint": "casing", "law": "-k*omega_c", "parameters": []}],
}
_SOURCE = {"key": "1", "file": "a.csv", "kind": "table", "body": "casing", "hub": [1, 2], "picks": []}
_PROFILE = (
    b'name = "wheel"\ncentre = "orbit"\ncapture_fps = 300\n[[marker]]\nname = "a"\n'
    b'colour = "red"\nbody = "casing"\nhue = 20.5\n'
)
_STUDY = (
    b'label = "x"\ninertia_rotor = "1e-5"\n[[clip]]\nfile = "a.mp4"\nbody = "casing"\ncapture_fps = 260\n'
)
_EFFECTS = (
    b'[[effect]]\nname = "lab.x"\nbody = "casing"\nlaw = "-k*omega_c"\n[effect.parameters.k]\n'
    b'unit = "N m s"\nstart = 1e-7\n'
)
_MANIFEST = (
    b'[defaults]\ninertia_rotor = "1e-5"\n[[clip]]\nfile = "w.mp4"\ncapture_fps = 260\n'
    b'[[case]]\ndata = "old.h5"\n'
)
_STEP = {
    "step": "a/fit",
    "key": "k",
    "fingerprint": "f",
    "seconds": 1.0,
    "trusted": True,
    "document": {"fit_id": "f1"},
}


def _read_table(path, _folder):
    import_body(path, 1e-5)


def _read_ledger(path, _folder):
    ledger = Ledger(path)
    for entry in ledger.entries:
        ledger.annotate(entry.fit_id, note="n")
        _ = entry.model, entry.prior, entry.choices, entry.diagnosis(None)
        entry.as_prior("x")


def _read_journal(path, _folder):
    journal = Journal(path)
    for name in journal._records:
        journal._records[name].get("document").get("fit_id")


def _read_state(path, folder):
    path.replace(folder / STATE_FILE)
    project = Project(folder)
    try:
        json.dumps(project.document(), allow_nan=False).encode()
        project.set("", "label", "x")
    finally:
        project.close()


KINDS = {
    "table.csv": (_table(",", ("t", "angle")), _read_table),
    "semicolons.txt": (_table(";", ("t [ms]", "phi [deg]")), _read_table),
    "objects.json": (
        json.dumps([{"t": t, "angle": a} for t, a in zip(*_COLUMNS.values(), strict=True)]).encode(),
        _read_table,
    ),
    "columns.json": (json.dumps(_COLUMNS).encode(), _read_table),
    "x.fits.json": (
        json.dumps({"format": "gyrotrack ledger", "version": 1, "fits": [_ENTRY]}).encode(),
        _read_ledger,
    ),
    "state.json": (json.dumps({"version": 1, "sources": [_SOURCE], "label": "x"}).encode(), _read_state),
    "batch.jsonl": (
        b"".join(
            json.dumps(line).encode() + b"\n" for line in ({"format": "gyrotrack batch", "version": 1}, _STEP)
        ),
        _read_journal,
    ),
    "profile.toml": (_PROFILE, lambda path, _: load(path)),
    "effects.toml": (_EFFECTS, lambda path, _: read_effects(path)),
    "manifest.toml": (_MANIFEST, lambda path, _: read_manifest(path)),
    "manifest.csv": (
        b"case,body,file,capture_fps\na,casing,c.mp4,260\na,rotor,r.mp4,1000\n",
        lambda path, _: read_manifest(path),
    ),
    "study.toml": (_STUDY, lambda path, _: read_study(path)),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_changed_file_is_read_or_refused(tmp_path_factory, name):
    content, read = KINDS[name]
    folder = tmp_path_factory.mktemp("mutations")
    read_well, sentences = [], set()

    @BUDGET
    @given(changes())
    def search(changed):
        path = folder / name
        path.write_bytes(changed(content))
        try:
            read(path, folder)
        except (GyrotrackError, FittingError) as error:
            sentences.add(bool(error.message))
        else:
            read_well.append(name)

    (folder / name).write_bytes(content)
    read(folder / name, folder)  # the seed itself is good
    search()
    assert read_well
    assert sentences <= {True}


@BUDGET
@given(changes(), st.booleans())
def test_a_changed_checkpoint_is_continued_or_begun_anew(tmp_path_factory, changed, valid):
    """Also with valid checksums, as in a file that was made on purpose."""
    output = tmp_path_factory.mktemp("checkpoint") / "o.h5"
    with CheckpointFile(output, {"film": "x"}) as journal:
        journal.append({"part": 0, "frames": 2}, {"stamps": np.arange(2), "a": np.ones((2, 2))})
        (start, end) = journal._ends
    path = checkpoint_path(output)
    whole = path.read_bytes()
    record = whole[start + 12 : end]
    if valid:
        record = changed(record)
        head = len(record).to_bytes(8, "little") + zlib.crc32(record).to_bytes(4, "little")
        path.write_bytes(whole[:start] + head + record)
    else:
        path.write_bytes(changed(whole))
    with suppress(OutputError), CheckpointFile(output, {"film": "x"}, resume=True) as journal:
        for found in journal.records():
            assert isinstance(found.facts, dict)
        frames_done(journal)
