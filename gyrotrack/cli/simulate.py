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
from gyrotrack.errors import UsageError
from gyrotrack.study import changed


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
    import secrets

    import numpy as np

    from fitting.effects import REDUCED
    from fitting.model import Model
    from fitting.simulation.recording import Experiment, simulate
    from gyrotrack.challenge import draw_effect, seal
    from gyrotrack.dataset.writing import refuse_existing
    from gyrotrack.simulated import draw_films, write_record

    out = Output(as_json=as_json, quiet=quiet)
    refuse_existing(output, force=force)
    experiment = Experiment(
        omega_rotor=omega_rotor,
        omega_casing=omega_casing,
        duration=duration,
        casing_fps=casing_fps,
        rotor_fps=rotor_fps,
        windows=tuple(window) if window else tuple(round(x * duration, 6) for x in (0.025, 0.35, 0.75)),
        window_length=window_length,
        sigma=sigma,
        torque_noise=torque_noise,
        torque_time=torque_time,
        centre_offset=centre_offset,
    )
    model = changed(Model.of(REDUCED), add or (), drop or (), own_effects(effects))
    if model.measurement:
        raise UsageError(
            "Measurement effects cannot be simulated this way.", "For a centre offset give --centre-offset."
        )
    sealed: Path | None = output.with_name(f"{output.stem}.seal.json") if hide else None
    if sealed is not None:
        refuse_existing(sealed, force=force)
        seed = secrets.randbits(48)
        drawn = draw_effect(model.names, random := np.random.default_rng(seed))
        model = model.with_effect(drawn)
        strength = float(strength * 2 ** random.uniform(-1, 1))
    numbers = _numbers(model, experiment, strength, set_values or ())
    with out.progress("simulating") as progress:
        progress(0, None)
        record = simulate(
            model,
            numbers,
            experiment,
            inertia_rotor=inertia_rotor,
            inertia_casing=inertia_casing,
            seed=seed,
            label=label if label is not None else output.stem,
        )
    settings: dict[str, Any] = {"experiment": vars(experiment)}
    document: dict[str, Any] = {"output": output}
    if sealed is None:
        document |= {"model": list(model.names), "parameters": numbers}
        settings |= {**document, "seed": seed}
    else:
        own = {k: v for k, v in numbers.items() if k.startswith(f"{drawn.name}.")}
        commitment = seal(sealed, drawn.name, own, force=force)
        document |= {"seal": sealed, "commitment": commitment}
        settings |= {"commitment": commitment}
    write_record(output, record, surface=surface, command=command_line(), settings=settings, force=force)
    films = []
    if film is not None:
        with out.progress("drawing films") as progress:
            films = draw_films(
                film,
                model,
                numbers,
                experiment,
                (inertia_rotor, inertia_casing),
                seed,
                force=force,
                progress=progress,
            )
    out.result({**document, "films": films})
    shown = (
        [f"  {key:<34}{value:.6g}" for key, value in numbers.items()]
        if sealed is None
        else [f"sealed: {sealed}"]
    )
    out.show("\n".join([*shown, f"written: {output}", *(f"written: {f}" for f in films)]))


def _numbers(model: Any, experiment: Any, strength: float, given: Any) -> dict[str, float]:
    from fitting.effects.typical import PAPER, typical_values

    speeds = {"omega_r": 0.6 * experiment.omega_rotor, "omega_c": 100.0}
    numbers: dict[str, float] = {}
    for effect in model.effects:
        numbers |= typical_values(effect, strength, duration=experiment.duration, speeds=speeds)
    numbers |= {k: v for k, v in PAPER.items() if k in numbers}
    for item in given:
        key, equals, value = item.partition("=")
        if not equals or key.strip() not in numbers:
            raise UsageError(
                f"{item[:60]!r} sets no parameter of the model.", f"It has: {', '.join(numbers)}."
            )
        try:
            numbers[key.strip()] = float(value)
        except ValueError:
            raise UsageError(
                f"{value[:30]!r} is not a number.", f"Write for example {key.strip()}=1e-9."
            ) from None
    return numbers
