"""The tables of rival methods on the same runs, and of other forms of the same data."""

from __future__ import annotations

from cells import NOISES
from judge import Line, Share, detected, right_first, right_named
from tabular import table


def rivals(rivals: list[Line], lines: list[Line]) -> str:
    """Return methods against each other on the same runs."""
    ours = {x["key"]: x for x in lines}
    methods = list(dict.fromkeys(m for x in rivals for m in x.get("answers", {})))
    rows = []
    for noise, words in NOISES:
        some = [x for x in rivals if x.get("noise") == noise and x["key"] in ours and "error" not in x]
        hidden, empty = [x for x in some if x["hidden"]], [x for x in some if not x["hidden"]]
        same = [ours[x["key"]] for x in hidden]
        rows.append(["`gyrotrack diagnose`", words, Share(map(right_first, same)), Share(map(right_named, same)),
                     Share(detected(ours[x["key"]]) for x in empty)])  # fmt: skip
        for m in methods:
            said = [{**x, "verdict": "missing_effect", "named": x["answers"][m]} for x in hidden]
            rows.append([m, words, Share(map(right_first, said)), Share(map(right_named, said)),
                         Share(bool(x["answers"][m]) for x in empty)])  # fmt: skip
    return table(
        ["method", "data", "right first", "right among the names", "a term named where nothing is"], rows
    )


def forms(forms: list[Line]) -> str:
    rows = [
        [x["form"], f"`{x['hidden'][0]}`" if x["hidden"] else "nothing", x["verdict"].replace("_", " "),
         ", ".join(f"`{n}`" for n in x["named"]) or "-", x.get("note", ""), f"{x['seconds']:.0f}"]
        for x in forms if "error" not in x
    ]  # fmt: skip
    rows += [[x["form"], "", "failed", x["error"], "", ""] for x in forms if "error" in x]
    return table(["form", "hidden", "verdict", "named", "what else", "s"], rows)
