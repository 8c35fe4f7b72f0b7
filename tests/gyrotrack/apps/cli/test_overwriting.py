"""No command replaces what it reads, whatever it is called: also with --force, also through a link."""

import os

import pytest

PROFILE = 'name = "x"\n[[marker]]\nname = "m"\ncolour = "red"\nbody = "casing"\n'
INERTIAS = ["--inertia-rotor", "1e-5", "--inertia-casing", "1e-5"]

# command, with the output last; the files that it reads or keeps
COMMANDS = {
    "extract": (["extract", "film.mp4", "--profile", "p.toml", "-o"], ["film.mp4", "p.toml"]),
    "extract overlay": (["extract", "film.mp4", "-o", "new.h5", "--overlay"], ["film.mp4"]),
    "extract sheet": (["extract", "film.mp4", "-o", "new.h5", "--contact-sheet"], ["film.mp4"]),
    "profile": (["profile", "film.mp4", "-o"], ["film.mp4"]),
    "profile picture": (["profile", "film.mp4", "-o", "new.toml", "--picture"], ["film.png"]),
    "sync": (["sync", "casing.h5", "rotor.h5", *INERTIAS, "-o"], ["casing.h5", "rotor.h5"]),
    "import": (
        ["import", "--casing", "c.csv", "--rotor", "r.csv", *INERTIAS, "-o"],
        ["c.csv", "r.csv"],
    ),
    "import body": (["import", "--body", "c.csv", "--inertia", "1e-5", "-o"], ["c.csv"]),
    "spindown": (["spindown", "film.mp4", "--profile", "p.toml", "-o"], ["p.toml"]),
    "spindown report": (["spindown", "film.mp4", "--profile", "p.toml", "--report"], ["p.toml"]),
    "export": (["export", "case.h5", "-o"], ["case.h5", "case.fits.json"]),
    "report": (
        ["report", "case.h5", "--ledger", "l.json", "-o"],
        ["case.h5", "case.fits.json", "l.json"],
    ),
    "scan csv": (["scan", "case.h5", "other.h5", "--csv"], ["case.h5", "other.h5", "other.fits.json"]),
    "scan latex": (["scan", "case.h5", "--latex"], ["case.h5", "case.fits.json"]),
    "laws": (["laws", "case.h5", "--picture"], ["case.png"]),
    "plan": (["plan", "case.h5", "--picture"], ["case.png"]),
    "compare": (["compare", "case.h5", "other.h5", "--picture"], ["case.png"]),
}
CASES = [(name, victim) for name, (_, victims) in COMMANDS.items() for victim in victims]


@pytest.mark.parametrize("link", [None, "hard", "symbolic"])
@pytest.mark.parametrize(("name", "victim"), CASES)
def test_no_command_replaces_what_it_reads(gyrotrack, tmp_path, monkeypatch, name, victim, link):
    monkeypatch.chdir(tmp_path)
    words = list(COMMANDS[name][0])
    if victim.endswith(".png"):  # the suffix is prescribed: the input is a link to that name
        source = "film.mp4" if victim == "film.png" else "case.h5"
        words = [victim if word == source else word for word in words]
    for file in {*words, *COMMANDS[name][1], "case.fits.json", "other.fits.json"}:
        if "." in file and not file.startswith("-") and "new" not in file and "e-" not in file:
            (tmp_path / file).write_text(PROFILE if file == "p.toml" else "precious")
    target = victim
    if link is not None:
        target = f"link{victim[victim.index('.') :]}"
        (os.link if link == "hard" else os.symlink)(victim, target)
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    said = gyrotrack(*words, target, "--force", "--json")
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert said.code == 1
    assert said.error["message"] == f"{target} is an input of this command."
