"""`gyrotrack simulate`: data, or film, of a model with any set of effects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from gyrotrack.cli.command_line import command_line
from gyrotrack.cli.options import (
    I_CASING,
    I_ROTOR,
    Force,
    InertiaCasing,
    InertiaRotor,
    Json,
    OutputFile,
    Quiet,
    Surface,
)
from gyrotrack.cli.output import Output
from gyrotrack.cli.study import EffectsFile, own_effects
from gyrotrack.study import changed

_WINDOWS = (0.025, 0.35, 0.75)  # when the rotor is filmed, as shares of the whole, if nothing is said


def command(
    *,
    output: OutputFile,
    add: Annotated[
        list[str] | None,
        typer.Option("--add", metavar="E", help="An effect beside the reduced model, by name or as a law."),
    ] = None,
    drop: Annotated[list[str] | None, typer.Option("--drop", metavar="E", help="Take an effect out.")] = None,
    effects: EffectsFile = None,
    set_values: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A parameter, as casing.air.quadratic.k=1e-9."),
    ] = None,
    strength: Annotated[
        float,
        typer.Option(
            "--strength",
            help="Torque of added effects over the budget of 1e-4 N m, where --set says nothing.",
        ),
    ] = 0.01,
    omega_rotor: Annotated[
        float, typer.Option("--omega-rotor", help="Speed of the rotor at the start [rad/s].")
    ] = 900.0,
    omega_casing: Annotated[
        float, typer.Option("--omega-casing", help="Speed of the casing at the start [rad/s].")
    ] = 5.0,
    duration: Annotated[float, typer.Option("--duration", help="Length of the recording [s].")] = 200.0,
    window: Annotated[
        list[float] | None, typer.Option("--window", metavar="T", help="Start of a rotor clip [s].")
    ] = None,
    window_length: Annotated[
        float, typer.Option("--window-length", help="Length of the rotor clips [s].")
    ] = 3.0,
    casing_fps: Annotated[float, typer.Option("--casing-fps", help="Frames a second on the casing.")] = 260.0,
    rotor_fps: Annotated[float, typer.Option("--rotor-fps", help="Frames a second on the rotor.")] = 1000.0,
    sigma: Annotated[float, typer.Option("--sigma", help="Noise of the angles [rad].")] = 1e-3,
    torque_noise: Annotated[
        float, typer.Option("--torque-noise", help="Rms of a random torque [N m].")
    ] = 0.0,
    torque_time: Annotated[float, typer.Option("--torque-time", help="Its correlation time [s].")] = 1.0,
    centre_offset: Annotated[
        float, typer.Option("--centre-offset", help="Once-a-turn error of the angle [rad].")
    ] = 0.0,
    seed: Annotated[int, typer.Option("--seed", help="Of all noise.")] = 0,
    film: Annotated[
        Path | None, typer.Option("--film", metavar="DIR", help="Draw the films as well, into this folder.")
    ] = None,
    hide: Annotated[
        bool, typer.Option("--hide", help="Draw an effect by lot and seal its name beside the case.")
    ] = False,
    label: Annotated[str | None, typer.Option("--label", metavar="L", help="Name of the case.")] = None,
    surface: Surface = "",
    inertia_rotor: InertiaRotor = I_ROTOR,
    inertia_casing: InertiaCasing = I_CASING,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a case of the paper's gyroscope with chosen effects, as data or as film.

    Example: gyrotrack simulate -o case.h5 --add casing.air.quadratic --strength 0.03
    """
    from fitting.effects import REDUCED
    from fitting.model import Model
    from fitting.simulation.recording import Experiment
    from gyrotrack.challenge import hide_effect
    from gyrotrack.dataset.writing import refuse_existing
    from gyrotrack.simulated import SimulatedRun, write_record

    out = Output(as_json=as_json, quiet=quiet)
    sealed = output.with_name(f"{output.stem}.seal.json") if hide else None
    for path in (output, sealed):
        if path is not None:
            refuse_existing(path, force=force)
    experiment = Experiment(
        omega_rotor=omega_rotor,
        omega_casing=omega_casing,
        duration=duration,
        casing_fps=casing_fps,
        rotor_fps=rotor_fps,
        windows=tuple(window) if window else tuple(round(x * duration, 6) for x in _WINDOWS),
        window_length=window_length,
        sigma=sigma,
        torque_noise=torque_noise,
        torque_time=torque_time,
        centre_offset=centre_offset,
    )
    model = changed(Model.of(REDUCED), add or (), drop or (), own_effects(effects))
    hidden = hide_effect(model, strength) if hide else None
    if hidden is not None:
        model, strength, seed = hidden.model, hidden.strength, hidden.seed
    inertias = (inertia_rotor, inertia_casing)
    run = SimulatedRun.of(model, strength, experiment, inertias, seed, set_values or ())
    with out.progress("simulating") as progress:
        progress(0, None)
        record = run.record(label if label is not None else output.stem)
    if sealed is None or hidden is None:
        told: dict[str, Any] = {"model": list(model.names), "parameters": run.numbers}
        settings: dict[str, Any] = {"output": output, **told, "seed": seed}
        lines = [f"  {key:<34}{value:.6g}" for key, value in run.numbers.items()]
    else:
        commitment = hidden.seal(sealed, run.numbers, force=force)
        told, settings = {"seal": sealed, "commitment": commitment}, {"commitment": commitment}
        lines = [f"sealed: {sealed}"]
    settings = {"experiment": vars(experiment), **settings}
    write_record(output, record, surface=surface, command=command_line(), settings=settings, force=force)
    films = []
    if film is not None:
        with out.progress("drawing films") as progress:
            films = run.films(film, force=force, progress=progress)
    out.result({"output": output, **told, "films": films})
    out.show("\n".join([*lines, *(f"written: {f}" for f in (output, *films))]))
