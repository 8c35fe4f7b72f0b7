"""A motor, a drum and a wheel on a chain of joints, from tables to answers, with recordings that SciPy integrates."""

import json
import re

import h5py
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting import Case, fit, load_fit
from fitting.inference._case_file import read_record
from gyrotrack import ErrorMode, UsageError, read_case, write_case
from gyrotrack.apps.workbench._server import Laboratory
from gyrotrack.io._contents import inspect_file

INERTIA = {"motor": 2e-4, "drum": 5e-4, "wheel": 1e-3}
JOINTS = {"belt": ("motor", "drum"), "bearing2": ("drum", "wheel")}
STATED = ["--joint", "belt=motor,drum", "--joint", "bearing2=drum,wheel"]
STATED += [word for body, value in INERTIA.items() for word in ("--inertia", f"{body}={value}")]
DRAG = 6e-7
UNITS = {"omega": "omega [rad/s]", "angle": "angle [rad]"}
KNOWN = ["motor.support.constant", "drum.air.linear", "belt.linear", "bearing2.linear"]
TIME = np.round(np.linspace(0.0, 20.0, 300), 6)


def rates(_, y):
    """Return the accelerations and the speeds of motor, drum and wheel."""
    motor, drum, wheel = y[:3]
    belt, bearing = 2e-4 * (motor - drum), 8e-5 * (drum - wheel)
    torques = (-belt - 2e-3, belt - bearing - 4e-5 * drum, bearing - DRAG * wheel**2)
    return [*(torque / i for torque, i in zip(torques, INERTIA.values(), strict=True)), *y[:3]]


@pytest.fixture(scope="module")
def values():
    """Return measured speeds and angles by body."""
    y = solve_ivp(rates, (0.0, 20.0), [300.0, 200.0, 50.0, 0.0, 0.0, 0.0], t_eval=TIME, rtol=1e-10).y
    noise = np.random.default_rng(3).standard_normal((6, len(TIME)))
    speeds = dict(zip(INERTIA, y[:3] + 0.1 * noise[:3], strict=True))
    return {"omega": speeds, "angle": dict(zip(INERTIA, y[3:] + 2e-3 * noise[3:], strict=True))}


def words_of(folder, columns, *, sense=1, quantity="omega", sigma=0.1):
    """Write a table for each body and return the options of `import`."""
    words = []
    for body, column in columns.items():
        rows = np.stack([TIME, sense * column, np.full(len(TIME), sigma)], axis=1)
        path = folder / f"{body}.csv"
        np.savetxt(path, rows, delimiter=",", header=f"t,{UNITS[quantity]},sigma", comments="", fmt="%.12g")
        words += ["--body", f"{body}={path}"]
    return words


@pytest.fixture(scope="module")
def case(tmp_path_factory, values, program):
    """Return a case file of the three bodies."""

    folder = tmp_path_factory.mktemp("chain")
    words = ["import", *words_of(folder, values["omega"]), *STATED, "-o", str(folder / "case.h5"), "-q"]
    assert program(words) == 0
    return folder / "case.h5"


def from_arrays(columns, quantity="omega", u=0.1):
    """Return the case of the same arrays."""
    bodies = {
        body: {"t": TIME, quantity: column, "u": u, "inertia": INERTIA[body]}
        for body, column in columns.items()
    }
    return Case.from_arrays(**bodies, joints=JOINTS, label="case")


class TestFile:
    @pytest.mark.parametrize(("quantity", "u"), [("omega", 0.1), ("angle", 2e-3)])
    def test_a_file_has_the_numbers_of_the_arrays(self, gyrotrack, tmp_path, values, quantity, u):
        path = tmp_path / "case.h5"
        columns = {name: np.round(column, 6) for name, column in values[quantity].items()}
        words = words_of(tmp_path, columns, quantity=quantity, sigma=u)
        assert gyrotrack("import", *words, *STATED, "-o", path).code == 0
        assert read_record(path).digest == from_arrays(columns, quantity, u).record.digest
        with h5py.File(path) as f:
            assert not {"casing", "rotor"} & {*f}
            stated = f["body/drum"].attrs
            assert (stated["role"], stated["place"], stated["inertia"]) == ("body", 1, 5e-4)
            assert list(f["joint/belt"].attrs["bodies"]) == ["motor", "drum"]
            assert f["body/wheel/series/fused/value"].attrs["units"] == ("rad s-1" if u == 0.1 else "rad")

    def test_a_case_comes_back(self, case, tmp_path):
        found = read_case(case)
        assert (found.bodies, found.main_body, found.joints) == ("chain", "motor", JOINTS)
        assert {name: i for name, (i, _) in found.inertias.items()} == INERTIA
        again = read_case(write_case(tmp_path / "again.h5", found, command="", settings={}))
        for (name, one), (other, two) in zip(found.motions, again.motions, strict=True):
            assert name == other
            np.testing.assert_array_equal(one.omega, two.omega)
        assert "I_wheel 0.001" in repr(again)

    def test_error_modes_of_each_body_come_back(self, case, tmp_path):
        """A mode of the drum is one of the second window of the record, the first after the main body."""
        found = read_case(case)
        mode = ErrorMode("rate", TIME[:, None], np.array([[1e-4]]), group="rate")
        drum, wheel = found.further
        object.__setattr__(wheel.series, "modes", (mode,))
        object.__setattr__(found.casing, "modes", (mode,))
        path = write_case(tmp_path / "modes.h5", found, command="", settings={})
        assert [(m.body, m.window) for m in read_record(path).modes] == [("casing", None), ("rotor", 1)]
        assert [m.name for m in read_case(path).further[1].series.modes] == ["rate"]
        assert not read_case(path).further[0].series.modes
        assert drum.name == "drum"

    def test_info_and_export(self, gyrotrack, case, tmp_path):
        said = gyrotrack("info", case, "--verify", "--json").json
        assert (said["sound"], said["bodies"], said["body_name"]) == (True, "chain", "motor")
        assert said["joints"] == {"belt": ["motor", "drum"], "bearing2": ["drum", "wheel"]}
        assert said["further"]["wheel"]["inertia"] == 1e-3
        assert said["further"]["wheel"]["windows"][0]["samples"] == len(TIME)
        shown = gyrotrack("info", case).out
        assert "belt between motor and drum" in shown
        assert "wheel 0.001 kg m2" in shown
        assert gyrotrack("export", case, "-o", tmp_path / "c.csv").code == 0
        labels = {line.partition(",")[0] for line in (tmp_path / "c.csv").read_text().splitlines()[1:]}
        assert labels == {*INERTIA}
        words = [w for b in INERTIA for w in ("--body", f"{b}={tmp_path / 'c.csv'}")]
        words += ["--column", "omega=omega [rad/s]", "--column", "sigma=omega_sigma [rad/s]"]
        assert gyrotrack("import", *words, *STATED, "-o", tmp_path / "again.h5").code == 0
        again = dict(read_case(tmp_path / "again.h5").motions)
        for name, series in read_case(case).motions:
            assert again[name].omega == pytest.approx(series.omega)

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda f: f["body/wheel"].attrs.__delitem__("inertia"), "wheel has no inertia"),
            (lambda f: f["body/wheel"].attrs.modify("inertia", -1.0), "inertia of the wheel is -1"),
            (lambda f: f["body/wheel"].attrs.modify("place", 0), "two bodies of the same place"),
            (lambda f: f["joint"].__delitem__("belt"), "no joint connects"),
            (lambda f: f.__delitem__("joint"), "no joint connects the bodies motor, drum, wheel"),
            (lambda f: f["joint/belt"].attrs.modify("bodies", ["motor", "disc"]), "between motor and disc"),
            (lambda f: f["joint/belt"].attrs.update(bodies=["motor"]), "names 1 of two bodies"),
            (lambda f: f["joint"].move("belt", "drum"), "same name"),
            (lambda f: f["body"].move("wheel", "casing"), "'casing' cannot be the name"),
            (lambda f: f["body/wheel/series/fused"].attrs.modify("quantity", "angle"), "speeds of one body"),
            (lambda f: f["body/wheel"].attrs.modify("role", "rotor"), "of the roles body, body, rotor"),
        ],
    )
    def test_damaged_files_are_refused_in_one_sentence(self, gyrotrack, case, tmp_path, change, words):
        path = tmp_path / "damaged.h5"
        path.write_bytes(case.read_bytes())
        with h5py.File(path, "r+") as f:
            change(f)
        for command in (["info", path], ["fit", path]):
            said = gyrotrack(*command, "--json")
            assert said.code == 1
            assert words in said.error["message"]

    def test_a_joint_with_the_ground_is_not_one_of_the_chain(self, case, tmp_path):
        path = tmp_path / "ground.h5"
        path.write_bytes(case.read_bytes())
        with h5py.File(path, "r+") as f:
            f["joint"].create_group("foot").attrs.update(bodies=["motor", "ground"], kind="contact")
        assert read_record(path).digest == read_record(case).digest

    def test_a_problem_of_any_body_is_named(self, case, tmp_path):
        path = tmp_path / "problem.h5"
        path.write_bytes(case.read_bytes())
        with h5py.File(path, "r+") as f:
            f["body/wheel/series/fused/time"][5] = 0.0
        assert [p for p in inspect_file(path).problems if "wheel window 0" in p]


class TestImport:
    @pytest.mark.parametrize(("senses", "sense"), [((-1, -1, -1), -1), ((-1, 1, 1), 1), ((1, 1, 1), 1)])
    def test_signs_are_reversed_if_all_bodies_turn_backwards(
        self, gyrotrack, tmp_path, values, senses, sense
    ):
        columns = {b: s * c for s, (b, c) in zip(senses, values["omega"].items(), strict=True)}
        words = words_of(tmp_path, columns)
        said = gyrotrack("import", *words, *STATED, "-o", tmp_path / "c.h5", "--json").json
        assert said["sense"] == sense
        for name, series in read_case(tmp_path / "c.h5").motions:
            assert series.omega == pytest.approx(sense * columns[name])

    def test_one_table_contains_all_bodies(self, gyrotrack, tmp_path, values):
        columns = values["omega"]
        table = tmp_path / "all.csv"
        header = "t," + ",".join(f"omega_{name}" for name in columns)
        np.savetxt(
            table, np.stack([TIME, *columns.values()], axis=1), delimiter=",", header=header, comments=""
        )
        words = [w for name in columns for w in ("--body", f"{name}={table}")]
        assert gyrotrack("import", *words, *STATED, "-o", tmp_path / "c.h5").code == 0
        for name, series in read_case(tmp_path / "c.h5").motions:
            assert series.omega == pytest.approx(columns[name])
        # without the names of the bodies the columns are given
        table.write_text(table.read_text().replace(header, "t,a,b,c"))
        words += [w for n, c in zip(columns, "abc", strict=True) for w in ("--column", f"{n}.omega={c}")]
        words += ["--column", "t=t"]
        assert gyrotrack("import", *words, *STATED, "-o", tmp_path / "d.h5").code == 0
        for name, series in read_case(tmp_path / "d.h5").motions:
            assert series.omega == pytest.approx(columns[name])

    def test_several_tables_of_a_body_are_its_windows(self, gyrotrack, tmp_path, values):
        words = words_of(tmp_path, values["omega"])
        lines = (tmp_path / "wheel.csv").read_text().splitlines()
        (tmp_path / "wheel.csv").write_text("\n".join(lines[:101]))
        (tmp_path / "late.csv").write_text("\n".join([lines[0], *lines[201:]]))
        words += ["--body", f"wheel={tmp_path / 'late.csv'}"]
        said = gyrotrack("import", *words, *STATED, "-o", tmp_path / "c.h5", "--json")
        assert [w["samples"] for w in said.json["further"]["wheel"]["windows"]] == [100, 100]
        runs = [run for run in read_record(tmp_path / "c.h5").rotor if run.state == 2]
        assert [len(run) for run in runs] == [100, 100]

    @pytest.mark.parametrize(
        ("drop", "add", "words"),
        [
            (["--joint", "belt=motor,drum"], [], "no joint connects"),
            (["--inertia", "wheel=0.001"], [], "wheel has no inertia"),
            ([], ["--joint", "rope=motor,disc"], "the joint rope is between motor and disc"),
            ([], ["--joint", "rope=motor"], "is not of the form"),
            ([], ["--joint", "belt=motor,wheel"], "its name is given twice"),
            ([], ["--inertia", "disc=1e-3"], "not the moment of inertia of one of the bodies"),
            ([], ["--inertia", "1e-3"], "not the moment of inertia of one of the bodies"),
            ([], ["--body", "nameless.csv"], "give the name of each body"),
            ([], ["--body-name", "disc"], "--body-name is the name of a single body"),
            ([], ["--casing", "casing.csv"], "either --casing and --rotor, or --body"),
        ],
    )
    def test_wrong_options_are_refused_in_one_sentence(self, gyrotrack, tmp_path, values, drop, add, words):
        stated = " ".join(STATED).replace(" ".join(drop), "").split() if drop else STATED
        said = gyrotrack(
            "import", *words_of(tmp_path, values["omega"]), *stated, *add, "-o", tmp_path / "c.h5", "--json"
        )
        assert said.code == 2
        assert words in said.error["message"]
        assert not (tmp_path / "c.h5").exists()

    def test_a_single_body_may_have_its_name(self, gyrotrack, tmp_path, values):
        words = words_of(tmp_path, {"wheel": values["omega"]["wheel"]})
        for inertia in ("1e-3", "wheel=1e-3"):
            path = tmp_path / f"{inertia}.h5"
            assert gyrotrack("import", *words, "--inertia", inertia, "-o", path).code == 0
            found = read_case(path)
            assert (found.bodies, found.body_name, found.I_casing) == ("one", "wheel", 1e-3)


class TestAnswers:
    @pytest.fixture
    def model(self, tmp_path):
        (tmp_path / "model.toml").write_text(f"effects = {json.dumps(KNOWN)}")
        return tmp_path / "model.toml"

    @pytest.mark.slow
    def test_a_law_of_one_body_is_added(self, gyrotrack, case, model, tmp_path):
        ledger = ["--ledger", tmp_path / "fits.json"]
        said = gyrotrack("fit", case, "--model", model, *ledger, "--json").json
        assert said["verdict"] == "lack_of_fit"
        assert [len(said["cases"][0]["further"]), said["cases"][0]["label"]] == [1, "case"]
        law = "wheel: -c*omega_wheel*abs(omega_wheel)"
        said = gyrotrack("fit", case, "--add", law, *ledger, "--json").json
        assert said["verdict"] == "no_lack_of_fit"
        assert said["model"] == [*KNOWN, law]
        found = said["parameters"][f"{law}.c"]
        assert abs(found["value"] - DRAG) < 4 * found["stderr"]
        shown = gyrotrack("ladder", case, *ledger).out
        assert law in shown
        # a stored fit is shown again without a search
        assert "rmse of the angular rate of the motor" in shown
        assert "inertia.drum" not in gyrotrack("budget", case, *ledger).out

    @pytest.mark.slow
    def test_own_laws_in_a_file(self, gyrotrack, case, model, tmp_path):
        effects = tmp_path / "own.toml"
        effects.write_text('[[effect]]\nname = "lab.drag"\nbody = "wheel"\nlaw = "-k*omega_wheel**2"\n')
        ledger = ["--ledger", tmp_path / "fits.json"]
        assert gyrotrack("fit", case, "--model", model, *ledger).code == 0
        said = gyrotrack("fit", case, "--add", "lab.drag", "--effects", effects, *ledger, "--json").json
        assert said["parameters"]["lab.drag.k"]["value"] == pytest.approx(DRAG, rel=0.01)

    def test_the_first_model_has_a_law_for_each_body_and_joint(self, gyrotrack, case, tmp_path):
        # without --model the first fit of a chain is linear
        said = gyrotrack("fit", case, "--ledger", tmp_path / "f.json", "--json").json
        assert set(said["model"]) == {
            "drum.air.quadratic", "wheel.air.quadratic", "motor.support.constant", "motor.air.linear",
            "belt.linear", "bearing2.linear",
        }  # fmt: skip

    def test_a_law_of_an_unknown_body_is_refused(self, gyrotrack, case, tmp_path):
        said = gyrotrack("fit", case, "--add", "disc: -c*omega", "--ledger", tmp_path / "f.json", "--json")
        assert said.code == 1
        assert "'disc' is an unknown body" in said.error["message"]

    def test_what_is_not_available_says_what_to_do(self, gyrotrack, case, model, tmp_path):
        ledger = ["--ledger", tmp_path / "f.json"]
        gyrotrack("fit", case, "--model", model, *ledger)
        for command, options, hint in (
            ("plan", ledger, "gyrotrack diagnose states upper limits"),
            ("laws", ledger, "fit your own laws"),
            ("scan", [], "gyrotrack improve adds"),
        ):
            said = gyrotrack(command, case, *options, "--json")
            assert said.code == 1
            assert "not available for several bodies with joints" in said.error["message"]
            assert said.error["hint"].startswith(hint)

    def test_a_generated_curve_is_one_of_a_gyroscope(self, gyrotrack, case, tmp_path):
        said = gyrotrack("fit", case, "--rotor", "generated", "--ledger", tmp_path / "f.json", "--json")
        assert said.code == 1
        assert "contains no rotor" in said.error["message"]

    def test_the_workbench_refuses_it(self, case, tmp_path):
        with pytest.raises(UsageError, match="does not show several bodies with joints"):
            Laboratory.open(case, [], tmp_path / "f.json")
        assert not (tmp_path / "f.json").exists()

    def test_a_fit_is_saved_and_read(self, values, tmp_path):
        law = "wheel: -c*omega_wheel*abs(omega_wheel)"
        made = fit([*KNOWN, law], from_arrays(values["omega"]))
        made.save(tmp_path / "fit.json")
        found = load_fit(tmp_path / "fit.json")
        assert found.model == made.model
        assert found.values == made.values
        assert len(found.cases[0].bodies) == 3
        again = found.refit([from_arrays(values["omega"]).record])
        assert again.chi2 == pytest.approx(made.chi2, rel=1e-6)

    @pytest.mark.slow
    @pytest.mark.release
    def test_the_hidden_law_is_named_and_reported(self, gyrotrack, case, model, tmp_path):
        ledger = ["--ledger", tmp_path / "fits.json"]
        gyrotrack("fit", case, "--model", model, *ledger)
        said = gyrotrack("diagnose", case, *ledger, "--json").json
        assert said["verdict"] == "missing_effect"
        assert said["candidates"][0]["effect"] == "wheel.air.quadratic"
        assert said["candidates"][0]["law"].startswith("wheel: ")
        gyrotrack("fit", case, "--add", "wheel.air.quadratic", *ledger)
        page = tmp_path / "report.html"
        assert gyrotrack("report", case, "-o", page, *ledger).code == 0
        text = page.read_text()
        for words in ("torque-wheel", "residual-drum", "on the motor", "moment of inertia of the drum"):
            assert words in text
        charts = {
            m[0]: m[1] for m in re.findall(r'"name": ?"([a-z-]+)", ?"title".*?"body": ?"([a-z]+)"', text)
        }
        assert (charts["torque-wheel"], charts["drum"], charts["energy"]) == ("wheel", "drum", "motor")
        assert not [w for w in ("the rotor", "the casing", "the bearing<") if w in text]

    @pytest.mark.slow
    @pytest.mark.release
    def test_an_answer_is_certified(self, gyrotrack, case, model, tmp_path):
        ledger = ["--ledger", tmp_path / "fits.json"]
        gyrotrack("fit", case, "--model", model, *ledger)
        said = gyrotrack("certify", case, *ledger, "-n", "1", "--workers", "1", "--json").json
        assert (said["null"]["alarms"], said["truth"]["right_first"]) == (0, 1.0)
