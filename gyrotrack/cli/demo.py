"""`gyrotrack demo`: the whole story on the sample clips, from film to the fallen error."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gyrotrack.cli.options import Json, Quiet
from gyrotrack.cli.output import Output
from gyrotrack.cli.tables import diagnosis_tables, fit_tables, ladder_tables
from gyrotrack.errors import DatasetError, GyrotrackError

if TYPE_CHECKING:
    from fitting.discovery import Diagnosis, Rung

_AT_ONCE = 2


def command(
    *,
    clips: Annotated[
        Path | None, typer.Option("--clips", metavar="DIR", help="Folder with study.toml and the films.")
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the results.")
    ] = Path("gyrotrack_demo"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run the whole story on the sample clips: film, angles, one clock, model, what is missing, report.

    Example: gyrotrack demo -o gyrotrack_demo
    """
    out = Output(as_json=as_json, quiet=quiet)
    began = perf_counter()
    folder = _find(clips)
    study = tomllib.loads((folder / "study.toml").read_text(encoding="utf-8"))
    output.mkdir(parents=True, exist_ok=True)
    out.show(f"1. Four films of one run, in {folder}: angles of the markers in every frame\n")
    recordings = _extract(out, folder, study["clip"], output)
    out.show("\n2. Both cameras on one clock, through the casing's angle that both see\n")
    case = output / "case.h5"
    casing = [r for r, c in zip(recordings, study["clip"], strict=True) if c["body"] == "casing"]
    rotors = [r for r, c in zip(recordings, study["clip"], strict=True) if c["body"] != "casing"]
    inertias = [
        "--inertia-rotor",
        str(study["inertia_rotor"]),
        "--inertia-casing",
        str(study["inertia_casing"]),
    ]
    names = ["--label", str(study["label"]), "--surface", str(study["surface"])]
    _run(out, ["sync", *casing, *rotors, "-o", case, *inertias, *names, "--force"])
    document = _study(out, case, output, folder / study["clip"][-1]["file"])
    document["seconds"] = perf_counter() - began
    out.result(document)
    out.show(f"\n{document['seconds']:.0f} s in all. The report: {document['report']}")


def _study(out: Output, case: Path, output: Path, film: Path) -> dict[str, Any]:
    """Fit, diagnose, improve and report; return what the program says of it."""
    from gyrotrack.dataset import read_case
    from gyrotrack.report import story_picture, write_report

    rungs, diagnosis, document = _found(out, case)
    out.show(f"\n6. The report\n\n$ gyrotrack report {case} -o {output / 'report.html'}")
    report = write_report(
        output / "report.html",
        rungs,
        diagnosis,
        recordings=[read_case(case)],
        provenance={"command": "gyrotrack demo"},
        force=True,
    )
    picture = story_picture(rungs, diagnosis, output / "story.png", frame=_frame(film), force=True)
    return {"case": case, "report": report, "picture": picture, **document}


def _found(out: Output, case: Path) -> tuple[list[Rung], Diagnosis, dict[str, Any]]:
    """Fit the reduced model, diagnose and improve it; return the ladder, the diagnosis, and both in JSON."""
    from fitting.discovery import diagnose, improve
    from fitting.effects import REDUCED
    from fitting.estimation import fit
    from fitting.ledger import Ledger
    from fitting.model import Model
    from fitting.summary import diagnosis_document, fit_document, ladder_verdict
    from gyrotrack.study import open_study

    ledger = Ledger.beside(case).path
    ledger.unlink(missing_ok=True)  # the demo begins anew each time
    study = open_study([case], None)
    out.show("\n3. The paper's reduced model", f"\n$ gyrotrack fit {case}\n")
    base = fit(Model.of(REDUCED), study.data)
    first = study.ledger.add(base, added="reduced")
    out.show(*fit_tables(base, first.fit_id))
    out.show("\n4. Where it fails, and which effect is missing", f"\n$ gyrotrack diagnose {case}\n")
    diagnosis = diagnose(base)
    out.show(*diagnosis_tables(diagnosis, first.fit_id))
    out.show("\n5. Add it, and watch the error fall", f"\n$ gyrotrack improve {case}\n")
    rungs = improve(base, first=diagnosis.candidates)
    kept = study.keep(rungs, first.fit_id)
    steps = [entry.document["rung"] for entry in kept]
    out.show(*ladder_tables(steps, study.data[0].record.body))
    return (
        rungs,
        diagnosis,
        {
            "diagnosis": diagnosis_document(diagnosis, first.fit_id),
            "ladder": steps,
            "final": fit_document(rungs[-1].fit, kept[-1].fit_id),
            "verdict": ladder_verdict(rungs),
        },
    )


def _frame(film: Path) -> Any:
    """Return the first frame of a film as red, green, blue."""
    import av

    with av.open(str(film)) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


def _find(clips: Path | None) -> Path:
    here = Path(__file__).resolve()
    places = [clips] if clips is not None else [Path("sample_clips"), here.parents[2] / "sample_clips"]
    for place in places:
        if (place / "study.toml").is_file():
            return place
    raise DatasetError(
        f"There are no sample clips in {places[0]}.",
        "Run it in the project's folder, or name the folder with --clips.",
    )


def _extract(out: Output, folder: Path, clips: Sequence[dict[str, Any]], output: Path) -> list[Path]:
    """Track all clips, two at a time, each in a process of its own."""
    jobs, targets = [], []
    for clip in clips:
        target = output / f"{Path(clip['file']).stem}.h5"
        rate = ["--capture-fps", str(clip["capture_fps"])]
        jobs.append(["extract", folder / clip["file"], *rate, "-o", target, "--force"])
        targets.append(target)
    with out.progress("tracking films") as progress, ThreadPoolExecutor(_AT_ONCE) as pool:
        for done, _ in enumerate(pool.map(lambda job: _run(out, job), jobs), 1):
            progress(done, len(jobs))
    return targets


def _run(out: Output, arguments: Sequence[object]) -> None:
    """Run one command of the program, show what it says, and pass its error on."""
    words = [str(a) for a in arguments]
    done = subprocess.run(  # noqa: S603 - our own program, no shell
        [sys.executable, "-m", "gyrotrack", *words, "--json", "-q"],
        capture_output=True,
        text=True,
        check=False,
    )
    document = json.loads(done.stdout or "{}")
    if "error" in document:
        error = document["error"]
        raise GyrotrackError(error["message"], error["hint"])
    out.show(f"$ gyrotrack {shlex.join(words)}\n" + _said(words[0], document))


def _said(verb: str, document: dict[str, Any]) -> str:
    if verb == "extract":
        bodies = ", ".join(
            f"{n} {b['samples']} angles +- {1e3 * b['median_sigma']:.2g} mrad"
            for n, b in document["body"].items()
        )
        return f"  {document['frames']} frames at {document['fps']:.0f}/s: {bodies}"
    lines = [
        f"  {Path(c['source']).name} starts at {c['offset_s']:.5f} s +- {1e3 * c['offset_sigma_s']:.2g} ms"
        + (" (ambiguous)" if c["ambiguous"] else "")
        for c in document.get("clips", [])
    ]
    return "\n".join(lines)
