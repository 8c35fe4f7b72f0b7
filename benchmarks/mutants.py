"""Deliberate faults in the modules that decide: which of them do the fast tests detect?

    python benchmarks/mutants.py map  -o DIR                 # which fast test executes which line, and its duration
    python benchmarks/mutants.py draw -o DIR --seed 1        # print the faults of a seed, run nothing
    python benchmarks/mutants.py run  -o DIR --seed 1        # plant each fault in a copy of the tree, run the tests

A fault is one change of one expression: a sign, a factor, an inverted or a shifted comparison, a dropped term, a
missing square root, minimum for maximum, an index off by one, a condition that always or never holds, an argument that
is ignored. Texts, annotations, error messages and warnings are not changed. A module is drawn in proportion to the root
of its length, then a kind of fault, then its place, so that frequent kinds do not dominate.

Each fault is tested by the fast tests that execute its line, quickest first: for `--first` seconds of their durations,
and if they pass, for `--wider` seconds more. The quickest tests of the other files that execute the module follow. A
survivor within these limits counts as not detected. Faults in `EQUIVALENT` change no result; they are listed
with the reason and not counted.

`map --tests FILE` adds test files to an earlier map. Results are appended to `DIR/mutants.jsonl`.
"""

import argparse
import ast
import copy
import json
import math
import os
import random
import shutil
import subprocess
import sys
import sysconfig
import time
import xml.etree.ElementTree as ET
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]

GROUPS = {
    "physics": (
        "fitting/effects/_library.py",
        "fitting/effects/_effect.py",
        "fitting/dynamics/_model.py",
        "fitting/dynamics/_collocation.py",
        "fitting/dynamics/_sensitivities.py",
        "fitting/dynamics/_events.py",
        "fitting/inference/_simulation.py",
        "gyrotrack/io/readers/_motion_table.py",
    ),
    "decisions": (
        "fitting/_criteria.py",
        "fitting/discovery/_select.py",
        "fitting/discovery/_verdict.py",
        "fitting/discovery/_lack_of_fit.py",
        "fitting/inference/_smooth_test.py",
        "fitting/inference/_periodogram.py",
        "fitting/inference/_random_torque.py",
        "fitting/discovery/_score.py",
        "fitting/discovery/_power.py",
        "fitting/discovery/_refine.py",
        "fitting/discovery/_named_effect.py",
        "fitting/discovery/_information.py",
        "fitting/discovery/_residuals.py",
        "fitting/discovery/_remainder.py",
        "fitting/discovery/_difference.py",
        "fitting/discovery/_oscillator.py",
    ),
    "inference": (
        "fitting/inference/_angle_noise.py",
        "fitting/inference/_process_noise.py",
        "fitting/inference/_noise.py",
        "fitting/inference/_case_data.py",
        "fitting/inference/_case_model.py",
        "fitting/inference/_compression.py",
        "fitting/inference/_prior.py",
        "fitting/inference/_metrics.py",
        "fitting/inference/_oscillation.py",
        "fitting/inference/_budget.py",
        "fitting/inference/_profile.py",
        "fitting/inference/_averaging.py",
        "fitting/inference/_fit.py",
        "fitting/inference/_initial_values.py",
    ),
    "tracking": (
        "gyrotrack/tracking/_texture.py",
        "gyrotrack/tracking/_body_angles.py",
        "gyrotrack/tracking/_film_parts.py",
        "gyrotrack/tracking/_fusion.py",
        "gyrotrack/tracking/_corners.py",
        "gyrotrack/tracking/_association.py",
        "gyrotrack/tracking/_aliasing.py",
        "gyrotrack/tracking/_frame_repeats.py",
        "gyrotrack/video/_time_base.py",
        "gyrotrack/synchronisation/_decision.py",
        "gyrotrack/synchronisation/_matching.py",
        "gyrotrack/io/readers/_pulses.py",
        "gyrotrack/io/readers/_clock.py",
        "gyrotrack/_smoothing.py",
        "gyrotrack/_correlated_noise.py",
    ),
}
"""Modules by group; `--modules` takes the names of groups or files."""

EQUIVALENT: dict[tuple[str, str, str], str] = {
    (
        "fitting/inference/_compression.py",
        "1e-06",
        "9.999999999999999e-06",
    ): "both formulas give the same sum, the second one with less rounding",
    (
        "fitting/dynamics/_events.py",
        "stop - first",
        "(stop + first)",
    ): "tolerance of an iteration; the time of rest is iterated to rounding in any case",
    (
        "fitting/dynamics/_events.py",
        "np.all(np.diff(places) > 0)",
        "np.any(np.diff(places) > 0)",
    ): "breaks within a stretch increase: either all steps are positive, or the only one is not",
    (
        "fitting/inference/_noise.py",
        "len(changed) - np.argmax(changed[::-1], axis=0)",
        "(len(changed) + np.argmax(changed[::-1], axis=0))",
    ): "zeros are added instead of left out",
    (
        "fitting/discovery/_random_torque.py",
        "np.abs(np.diag(np.linalg.qr(whitener(both), mode='r')))",
        "np.diag(np.linalg.qr(whitener(both), mode='r'))",
    ): "only its square counts",
}
"""(file, before, after) of faults that change no result, with the reason."""

SWAPPED = {
    "min": "max",
    "minimum": "maximum",
    "nanmin": "nanmax",
    "argmin": "argmax",
    "nanargmin": "nanargmax",
    "any": "all",
    "sin": "cos",
    "floor": "ceil",
}
SWAPPED |= {b: a for a, b in SWAPPED.items()}
INVERTED = {
    ast.Lt: ast.Gt,
    ast.Gt: ast.Lt,
    ast.LtE: ast.GtE,
    ast.GtE: ast.LtE,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
SHIFTED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
OPPOSITE = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
SILENT = {"warn", "print", "debug", "info", "warning", "TypeVar", "getLogger", "NewType"}
"""Calls whose arguments are texts for people."""
SHOWN = {"plot", "sentence", "words", "_sentence", "_repr_html_", "__repr__", "__str__", "latex"}
"""Functions that only draw or word a result; their texts have tests of their own."""


@dataclass(frozen=True)
class Fault:
    """One change of one expression, at `line` of `file`."""

    file: str
    line: int
    last: int  # last line of the smallest statement that contains it
    kind: str
    before: str
    after: str
    start: int  # offsets in the bytes of the file
    stop: int
    names: tuple[str, ...] = ()  # constants of the module that the changed statement defines

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.kind}: {self.before}  ->  {self.after}"

    def planted(self, source: bytes) -> bytes:
        return source[: self.start] + self.after.encode() + source[self.stop :]


class _Places(ast.NodeVisitor):
    """Collects all faults of one module."""

    def __init__(self, file: str, source: bytes) -> None:
        self.file, self.source = file, source
        self.faults: list[Fault] = []
        self.starts = [0, 0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.statement: ast.stmt | None = None
        self.depth = 0
        self.visit(ast.parse(source))

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.FunctionDef) and (node.name in SHOWN or node.name.startswith("_draw")):
            return
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            # neither decorators nor annotations; defaults are visited
            self.depth += isinstance(node, ast.FunctionDef)
            outer, self.statement = self.statement, node
            if isinstance(node, ast.FunctionDef):
                for default in (*node.args.defaults, *filter(None, node.args.kw_defaults)):
                    self.visit(default)
                self._ignored_arguments(node)
            for part in node.body:
                self.visit(part)
            self.statement = outer
            self.depth -= isinstance(node, ast.FunctionDef)
            return
        if isinstance(node, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom | ast.JoinedStr):
            return
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in SILENT:
            return
        outer = self.statement
        if isinstance(node, ast.stmt):
            self.statement = node
        self._of(node)
        if isinstance(node, ast.AnnAssign):
            if node.value is not None:
                self.visit(node.value)
        else:
            self.generic_visit(node)
        self.statement = outer

    def _add(self, kind: str, node: ast.expr, new: ast.expr) -> None:
        before, after = ast.unparse(node), ast.unparse(new)
        if not isinstance(new, ast.Name | ast.Constant | ast.Call | ast.Attribute | ast.Subscript):
            after = f"({after})"
        statement = self.statement or node
        names: tuple[str, ...] = ()
        if self.depth == 0 and isinstance(statement, ast.Assign | ast.AnnAssign):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names = tuple(n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name))
        whole = isinstance(
            statement, ast.If | ast.For | ast.While | ast.With | ast.FunctionDef | ast.ClassDef
        )
        last = node.end_lineno if whole else statement.end_lineno
        first = node.lineno if whole else statement.lineno
        self.faults.append(
            Fault(
                self.file, node.lineno, max(last, first), kind, before, after,
                self.starts[node.lineno] + node.col_offset, self.starts[node.end_lineno] + node.end_col_offset, names,
            )
        )  # fmt: skip

    def _of(self, node: ast.AST) -> None:
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            self._number(node)
        elif isinstance(node, ast.BinOp):
            self._operator(node)
        elif isinstance(node, ast.UnaryOp):
            if isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
                self._add("sign", node, node.operand)
            elif isinstance(node.op, ast.Not | ast.Invert):
                self._add("condition", node, node.operand)
        elif isinstance(node, ast.Compare) and len(node.ops) == 1:
            self._comparison(node)
        elif isinstance(node, ast.BoolOp):
            other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            self._add("condition", node, ast.BoolOp(other, node.values))
            for k in range(len(node.values)):
                rest = [v for i, v in enumerate(node.values) if i != k]
                self._add("condition", node, rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest))
        elif isinstance(node, ast.IfExp):
            self._add("condition", node, ast.IfExp(node.test, node.orelse, node.body))
        elif isinstance(node, ast.If | ast.While):
            self._add("condition", node.test, ast.UnaryOp(ast.Not(), node.test))
        elif isinstance(node, ast.Call):
            self._call(node)
        elif isinstance(node, ast.AugAssign) and type(node.op) in OPPOSITE:
            text = ast.get_source_segment(self.source.decode(), node)
            symbol = {ast.Add: "+=", ast.Sub: "-=", ast.Mult: "*=", ast.Div: "/="}
            old, new = symbol[type(node.op)], symbol[OPPOSITE[type(node.op)]]
            if text and text.count(old) == 1:
                start = self.starts[node.lineno] + node.col_offset + len(text[: text.index(old)].encode())
                self.faults.append(
                    Fault(self.file, node.lineno, node.end_lineno, "sign", old, new, start, start + 2)
                )

    def _number(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, int) and abs(value) < 10:
            self._add("off by one", node, ast.Constant(value + 1))
            if value > 0:
                self._add("off by one", node, ast.Constant(value - 1))
        elif value:
            for factor in (0.1, 0.5, 2.0, 10.0):
                new = value * factor
                self._add("factor", node, ast.Constant(round(new) if isinstance(value, int) else new))
        else:
            self._add("factor", node, ast.Constant(2.0))

    def _operator(self, node: ast.BinOp) -> None:
        texts = (
            isinstance(n, ast.JoinedStr) or isinstance(getattr(n, "value", None), str) for n in ast.walk(node)
        )
        if any(texts):
            return
        new = OPPOSITE.get(type(node.op))
        if new is not None:
            kind = "sign" if new in (ast.Add, ast.Sub) else "factor"
            self._add(kind, node, ast.BinOp(node.left, new(), node.right))
            self._add("dropped term", node, node.left)
            if new is not ast.Mult:
                self._add("dropped term", node, node.right)
        if isinstance(node.op, ast.Pow):
            self._add("missing power", node, node.left)
        if isinstance(node.op, ast.BitAnd | ast.BitOr):
            other = ast.BitOr() if isinstance(node.op, ast.BitAnd) else ast.BitAnd()
            self._add("condition", node, ast.BinOp(node.left, other, node.right))
            self._add("condition", node, node.left)
            self._add("condition", node, node.right)

    def _comparison(self, node: ast.Compare) -> None:
        kind = type(node.ops[0])
        if kind in INVERTED:
            self._add("comparison", node, ast.Compare(node.left, [INVERTED[kind]()], node.comparators))
        if kind in SHIFTED and self._counts(node):  # of floats that is no change
            self._add("off by one", node, ast.Compare(node.left, [SHIFTED[kind]()], node.comparators))
        if kind in SHIFTED:
            side = node.comparators[0]
            for factor in (0.3, 3.0):
                moved = ast.BinOp(ast.Constant(factor), ast.Mult(), copy.deepcopy(side))
                if not (isinstance(side, ast.Constant) and side.value == 0):
                    self._add("threshold", node, ast.Compare(node.left, node.ops, [moved]))

    @staticmethod
    def _counts(node: ast.Compare) -> bool:
        return any(
            (isinstance(n, ast.Constant) and type(n.value) is int and n.value != 0)
            or (isinstance(n, ast.Call) and getattr(n.func, "id", "") == "len")
            for n in ast.walk(node)
        )

    def _call(self, node: ast.Call) -> None:
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if name in SWAPPED:
            changed = copy.deepcopy(node)
            if isinstance(changed.func, ast.Attribute):
                changed.func.attr = SWAPPED[name]
            else:
                changed.func.id = SWAPPED[name]
            self._add("swapped", node, changed)
        if name in ("sqrt", "abs", "log", "exp", "square") and len(node.args) == 1:
            self._add("missing function", node, node.args[0])
        if name in ("max", "min", "maximum", "minimum", "clip") and len(node.args) > 1:
            self._add("dropped term", node, node.args[0])

    def _ignored_arguments(self, node: ast.FunctionDef) -> None:
        """Replace an argument that has a default by this default, in the first statement that uses it."""
        positional = [*node.args.posonlyargs, *node.args.args]
        pairs = [*zip(positional[::-1], node.args.defaults[::-1], strict=False)]
        pairs += [
            (a, d) for a, d in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True) if d is not None
        ]
        for argument, default in pairs:
            uses = [
                n
                for part in node.body
                for n in ast.walk(part)
                if isinstance(n, ast.Name) and n.id == argument.arg and isinstance(n.ctx, ast.Load)
            ]
            if len(uses) == 1 and not any(
                isinstance(n, ast.JoinedStr) for p in node.body for n in ast.walk(p)
            ):
                outer, self.statement = self.statement, uses[0]
                self._add("ignored argument", uses[0], default)
                self.statement = outer


def faults_of(file: str, root: Path = ROOT) -> list[Fault]:
    """Return all faults of a module."""
    return list(dict.fromkeys(_Places(file, (root / file).read_bytes()).faults))


def is_a_change(fault: Fault, root: Path = ROOT) -> bool:
    """Return whether the changed module can be compiled and differs in more than its layout."""
    source = (root / fault.file).read_bytes()
    try:
        return ast.dump(ast.parse(fault.planted(source))) != ast.dump(ast.parse(source))
    except (SyntaxError, ValueError):
        return False


def draw(files: list[str], count: int, seed: int) -> list[Fault]:
    """Draw faults: a module by the root of its length, a kind, a place."""
    chance = random.Random(seed)  # noqa: S311 - not for secrets
    places = {f: defaultdict(list) for f in files}
    for f in files:
        for fault in faults_of(f):
            places[f][fault.kind].append(fault)
    weights = [math.sqrt(len((ROOT / f).read_bytes())) for f in files]
    drawn: list[Fault] = []
    while len(drawn) < count:
        kinds = places[chance.choices(files, weights)[0]]
        fault = chance.choice(kinds[chance.choice(sorted(kinds))]) if kinds else None
        if fault is not None and fault not in drawn and is_a_change(fault):
            drawn.append(fault)
    return drawn


class Map:
    """Which test executes which line of the program, and how long it takes [s]."""

    def __init__(self, folder: Path) -> None:
        from coverage import CoverageData

        self.data = CoverageData(str(folder / "coverage"))
        self.data.read()
        self.files = {Path(f).relative_to(ROOT).as_posix(): f for f in self.data.measured_files()}
        self.seconds: dict[str, float] = {}
        cases = (c for f in sorted(folder.glob("durations*.xml")) for c in ET.parse(f).iter("testcase"))  # noqa: S314
        for case in cases:
            parts = case.get("classname", "").split(".")
            file = next(
                (
                    k
                    for k in range(len(parts), 0, -1)
                    if (ROOT / Path(*parts[:k])).with_suffix(".py").is_file()
                ),
                0,
            )
            path = "/".join(parts[:file]) + ".py"
            name = "::".join([path, *parts[file:], case.get("name", "")])
            self.seconds[name] = float(case.get("time", 0.0))

    def _tests(self, contexts: set[str]) -> list[str]:
        names = {c.rpartition("|")[0] for c in contexts if c}
        return sorted((n for n in names if n in self.seconds), key=lambda n: self.seconds[n])

    def at(self, fault: Fault) -> list[str]:
        """Return the tests that execute the line, or for a constant those that execute a line that uses it."""
        found: set[str] = set()
        if fault.names:
            wanted = set(fault.names)
            for file, name in self.files.items():
                tree = ast.parse((ROOT / file).read_bytes())
                own = file == fault.file
                if not own and not any(
                    isinstance(n, ast.ImportFrom) and wanted & {a.name for a in n.names}
                    for n in ast.walk(tree)
                ):
                    continue
                lines = self.data.contexts_by_lineno(name)
                for n in ast.walk(tree):
                    if getattr(n, "id", getattr(n, "attr", None)) in wanted:
                        found.update(lines.get(n.lineno, ()))
        elif fault.file in self.files:
            lines = self.data.contexts_by_lineno(self.files[fault.file])
            for k in range(fault.line, fault.last + 1):
                found.update(lines.get(k, ()))
            if not found:  # the statement begins above the expression
                for k in range(fault.line - 1, max(fault.line - 12, 0), -1):
                    if k in lines:
                        found.update(lines[k])
                        break
        return self._tests(found)

    def of_module(self, file: str) -> list[str]:
        if file not in self.files:
            return []
        lines = self.data.contexts_by_lineno(self.files[file])
        return self._tests({c for contexts in lines.values() for c in contexts})


def _copy(folder: Path) -> Path:
    """Copy the tree, with the compiled kernels, and with a start that imports this copy."""
    tree = folder / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split("\n")
    for name in filter(None, listed):
        if (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
    built = Path(sysconfig.get_paths()["platlib"]) / "gyrotrack" / "_native"
    for kernels in built.glob("_compiled*") if built.is_dir() else ():
        shutil.copy2(kernels, tree / "gyrotrack" / "_native" / kernels.name)
    (tree / ".start").mkdir()
    (tree / ".start" / "sitecustomize.py").write_text(
        "import sys\n"
        "sys.meta_path[:] = [f for f in sys.meta_path if 'ScikitBuild' not in type(f).__name__]\n"
        f"sys.path.insert(0, {str(tree)!r})\n"
    )
    return tree


def _passes(tree: Path, tests: list[str], limit: float) -> tuple[bool, str]:
    """Run tests in the copy until one fails; return whether all pass, and the first that fails."""
    (tree / ".start" / "tests").write_text("\n".join(tests) + "\n")
    start = tree / ".start"
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider"]
    environment = {**os.environ, "PYTHONPATH": str(start), "OPENBLAS_NUM_THREADS": "1"}
    with (start / "log").open("w+") as log:
        process = subprocess.Popen(
            [*command, "-p", "no:randomly", f"@{start / 'tests'}"],
            cwd=tree, env=environment, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        try:
            code = process.wait(limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.wait()
            return False, f"no end within {limit:.0f} s"
        log.seek(0)
        lines = [
            x for x in log.read().splitlines() if x.startswith(("FAILED", "ERROR", "E ", "INTERNALERROR"))
        ]
    if code not in (0, 1, 2):  # 5: nothing was collected
        message = (start / "log").read_text()[-600:]
        if code == 5 or "not found" in message or "no tests ran" in message:
            raise SystemExit(f"the tests could not be run (exit {code}):\n{message}")
        return False, f"exit {code}"
    return code == 0, (lines or [f"exit {code}"])[0]


def _within(tests: list[str], seconds: dict[str, float], budget: float) -> list[str]:
    """Return the first tests whose durations sum to at most a budget [s], at least one."""
    chosen: list[str] = []
    for name in tests:
        budget -= seconds.get(name, 0.0) + 0.005
        if budget < 0 and chosen:
            break
        chosen.append(name)
    return chosen


def _verdict(fault: Fault, tree: Path, tests: Map, options: argparse.Namespace) -> tuple[bool, str]:
    """Plant a fault, and return whether it is detected, and by which test."""
    path = tree / fault.file
    source = path.read_bytes()
    direct = tests.at(fault)
    first = _within(direct, tests.seconds, options.first)
    further = [n for n in direct if n not in set(first)]
    seen = {n.partition("::")[0] for n in direct}
    others = [n for n in tests.of_module(fault.file) if n.partition("::")[0] not in seen]
    wider = [
        *_within(further, tests.seconds, options.wider),
        *_within(others, tests.seconds, 0.2 * options.wider),
    ]
    stages = [first, wider]
    path.write_bytes(fault.planted(source))
    try:
        for stage in filter(None, stages):
            limit = 60.0 + 4.0 * sum(tests.seconds.get(n, 1.0) for n in stage)
            passed, where = _passes(tree, stage, limit)
            if not passed:
                return True, where
    finally:
        path.write_bytes(source)
        os.utime(path, (time.time() + 2, time.time() + 2))  # compiled modules are compared by this time
    return False, f"{len(direct)} tests execute it"


def _run(options: argparse.Namespace, folder: Path) -> None:
    files = [f for m in options.modules for f in GROUPS.get(m, (m,))]
    drawn = draw(files, options.count, options.seed)
    if options.at:
        drawn = [f for file in files for f in faults_of(file) if f"{f.file}:{f.line}" in options.at]
    if options.command == "draw":
        print(*drawn, sep="\n")
        return
    tests, tree = Map(folder), _copy(folder)
    shares: dict[str, Counter[bool]] = defaultdict(Counter)
    for n, fault in enumerate(drawn):
        reason = EQUIVALENT.get((fault.file, fault.before, fault.after))
        if reason is not None:
            print(f"{n + 1:3d} equivalent {fault} ({reason})", flush=True)
            continue
        began = time.monotonic()
        detected, where = _verdict(fault, tree, tests, options)
        shares[fault.file][detected] += 1
        took = time.monotonic() - began
        print(
            f"{n + 1:3d} {'detected' if detected else 'SURVIVED'} {took:3.0f} s {fault} [{where}]", flush=True
        )
        with (folder / "mutants.jsonl").open("a") as out:
            record = {**asdict(fault), "seed": options.seed, "detected": detected, "where": where}
            out.write(json.dumps(record) + "\n")
    for file, share in sorted(shares.items()):
        print(f"{share[True]:3d} of {share.total():3d}  {file}")
    total = sum(shares.values(), Counter())
    print(
        f"detected {total[True]} of {total.total()} ({total[True] / max(total.total(), 1):.0%}), seed {options.seed}"
    )


def _map(options: argparse.Namespace, folder: Path) -> None:
    """Run the fast tests, or some test files in addition to an earlier map, with the name of each test as context."""
    (folder / "coveragerc").write_text(
        f"[run]\nbranch = false\nsource =\n    gyrotrack\n    fitting\ndata_file = {folder / 'coverage'}\n"
    )
    if not options.tests:
        for old in folder.glob("durations*.xml"):
            old.unlink()
    durations = folder / f"durations{len(list(folder.glob('durations*.xml')))}.xml"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *(options.tests or ["tests"])]
    command += ["--cov", "--cov-context=test", f"--cov-config={folder / 'coveragerc'}", "--cov-report="]
    command += ["--cov-append"] if options.tests else []
    subprocess.run([*command, f"--junitxml={durations}"], cwd=ROOT, check=False)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("command", choices=("map", "draw", "run"))
    parser.add_argument("-o", "--output", required=True, help="folder for the map, the copy and the results")
    parser.add_argument("--modules", nargs="+", default=[*GROUPS], help="groups or files")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=float, default=5.0, help="seconds of the tests that are run first")
    parser.add_argument(
        "--wider", type=float, default=40.0, help="seconds of those that are run for survivors"
    )
    parser.add_argument(
        "--tests", nargs="*", default=[], help="with `map`: only these test files, in addition"
    )
    parser.add_argument(
        "--at", nargs="*", default=[], help="FILE:LINE, all faults there instead of a drawing"
    )
    options = parser.parse_args()
    folder = Path(options.output).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    (_map if options.command == "map" else _run)(options, folder)


if __name__ == "__main__":
    main()
