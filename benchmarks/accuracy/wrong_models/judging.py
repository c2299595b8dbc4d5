"""Whether an answer is right: values and intervals against the truth, causes against the fault; and the bars."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

#: An answer is confidently wrong where it is called done and a parameter is off by more than both.
OFF_STD, OFF = 3.0, 0.05
#: Of two faults both must be among so many causes.
BOTH_AMONG = 4


@dataclass(frozen=True)
class Judged:
    """One study, judged.

    Attributes
    ----------
    name, record : str
    faults : tuple of str
        Empty for twins, those with harmless errors too.
    harmless : bool
        A twin whose model has errors that do not matter.
    exit_code : int or None
        None where the time limit ended the run.
    verdict : str or None
        None where the answer has none.
    covered, counted : int
        Parameters with a 95 % interval and a truth, and how many of the intervals hold it.
    worst : str
        The parameter that is farthest off, in words.
    confidently_wrong : bool
    ranks : tuple of (int or None)
        Of each fault: the place of the first cause that names it, from 1.
    false_causes : tuple of str
        Causes of twins that name nothing that is there.
    seconds : float
        Wall time of `structid identify`.
    chi_square : float or None
        Per degree of freedom.
    causes : tuple of str
    """

    name: str
    record: str
    faults: tuple[str, ...]
    harmless: bool
    exit_code: int | None
    verdict: str | None
    covered: int
    counted: int
    worst: str
    confidently_wrong: bool
    ranks: tuple[int | None, ...]
    false_causes: tuple[str, ...]
    seconds: float
    chi_square: float | None
    causes: tuple[str, ...]

    @property
    def said(self) -> str:
        """Verdict, or what the exit code says of it."""
        codes = {0: "exit 0", 1: "exit 1", 2: "exit 2", 3: "wrong_model", None: "time out"}
        return self.verdict or codes.get(self.exit_code, f"exit {self.exit_code}")


def places(where: Any) -> set[str]:
    """What a cause's `where` names, in small pieces: "columns:2/4RZ" names columns:2, columns, 4RZ and 4."""
    if isinstance(where, dict):
        where = list(where.values())
    texts = [where] if isinstance(where, str | int) else list(where or ())
    found: set[str] = set()
    for piece in (piece for text in texts for piece in re.split(r"[,/;\s]+", str(text)) if piece):
        piece = re.sub(r"^(\d+)[:_]?(-?)(R?[XYZ])[+-]?$", r"\1\3", piece)
        found.add(piece)
        if node := re.match(r"^(\d+)R?[XYZ]$", piece):
            found.add(node[1])
        if element := re.match(r"^(.+):\d+$", piece):
            found.add(element[1])
    return found


def names(cause: dict[str, Any], fault: dict[str, Any]) -> bool:
    """Whether a cause names a fault of truth.json: one of the accepted kinds, at all that its place must name."""
    found = places(cause.get("where"))
    return any(cause.get("kind") == one["kind"] and set(one["where"]) <= found for one in fault["accepted"])


def judged(truth: dict[str, Any], answer: dict[str, Any] | None, exit_code: int | None, seconds: float) -> Judged:
    """One study: what truth.json says against estimate.json, which is None where it was not written."""
    answer = answer or {}
    rows = [(p, truth["parameters"].get(p["name"])) for p in answer.get("parameters", ())]
    known = [(p, true) for p, true in rows if true is not None and p["value"] is not None]
    with_ends = [(p["interval_95"], true) for p, true in known if None not in (p["interval_95"] or [None])]
    off = [
        (abs(p["value"] - true) / p["std"] if p["std"] else 0.0, abs(p["value"] / true - 1), p["name"])
        for p, true in known
    ]
    verdict, causes = answer.get("verdict"), answer.get("causes") or []
    confident = verdict in ("sound", "approximate") or (exit_code == 0 and verdict is None)
    farthest = max(off, key=lambda one: min(one[0] / OFF_STD, one[1] / OFF), default=(0.0, 0.0, ""))
    faults = truth["faults"]
    ranks = tuple(next((k for k, cause in enumerate(causes, 1) if names(cause, fault)), None) for fault in faults)
    twin = truth["harmless"] or not faults
    false = [cause for cause in causes if twin and not any(names(cause, fault) for fault in faults)]
    return Judged(
        name=truth["name"],
        record=truth["record"],
        faults=() if twin else tuple(f"{f['kind']} {f['where']} {f['size']}".strip() for f in faults),
        harmless=truth["harmless"],
        exit_code=exit_code,
        verdict=verdict,
        covered=sum(low <= true <= high for (low, high), true in with_ends),
        counted=len(with_ends),
        worst=f"{farthest[2]} {100 * farthest[1]:.1f} %, {farthest[0]:.1f} std" if farthest[2] else "",
        confidently_wrong=confident and farthest[0] > OFF_STD and farthest[1] > OFF,
        ranks=() if twin else ranks,
        false_causes=tuple(_words(cause) for cause in false),
        seconds=seconds,
        chi_square=answer.get("chi_square_per_dof"),
        causes=tuple(_words(cause) for cause in causes[:BOTH_AMONG]),
    )


def _words(cause: dict[str, Any]) -> str:
    where = cause.get("where")
    return f"{cause.get('kind')} {where if isinstance(where, str) else ' '.join(map(str, where or ()))}".strip()


def line(one: Judged) -> str:
    """A row of the table."""
    ranks = ",".join("-" if rank is None else str(rank) for rank in one.ranks) if one.verdict else ""
    marks = " CONFIDENTLY WRONG" if one.confidently_wrong else ""
    marks += f" false: {'; '.join(one.false_causes)}" if one.false_causes else ""
    chi = "" if one.chi_square is None else f"{one.chi_square:.3g}"
    return (
        f"{one.name:58s} {one.said:12s} {chi:>9s} {one.covered:3d}/{one.counted:<3d} {ranks:>5s} {one.seconds:6.1f} s  "
        f"{one.worst}{marks}"
    )


HEADER = f"{'study':58s} {'verdict':12s} {'chi2/dof':>9s} {'covered':>7s} {'cause':>5s} {'time':>8s}  farthest off"


def summary(rows: Sequence[Judged]) -> list[dict[str, Any]]:
    """The bars: what, bar, figure (parts of 1, or a count), met (None where it cannot be judged) and detail."""
    single = [one for one in rows if len(one.faults) == 1]
    double = [one for one in rows if len(one.faults) == 2]
    twins = [one for one in rows if not one.faults]
    told = any(one.verdict for one in rows)

    def share(
        what: str, bar: str, of: Sequence[Judged], holds: Callable[[Judged], bool], judge: bool = True
    ) -> dict[str, Any]:
        hits = sum(holds(one) for one in of)
        return _row(
            what, bar, hits / len(of) if of and judge else None, f"{hits} of {len(of)}" if judge else "no causes yet"
        )

    def within(count: int) -> Callable[[Judged], bool]:
        return lambda one: all(rank is not None and rank <= count for rank in one.ranks)

    return [
        share("single fault: cause first", ">= 0.85", single, within(1), told),
        share("single fault: cause among the first three", ">= 0.95", single, within(3), told),
        share(f"two faults: both among the first {BOTH_AMONG}", ">= 0.70", double, within(BOTH_AMONG), told),
        _row("confidently wrong", "<= 0", sum(one.confidently_wrong for one in rows), f"of {len(rows)}"),
        share("right model: called wrong", "<= 0.01", twins, lambda one: one.said == "wrong_model"),
        share("right model: false causes", "<= 0.01", twins, lambda one: bool(one.false_causes), told),
        _covered("single fault, not called wrong: 95 % intervals", ">= 0.90", single),
        _covered("right model without any error: 95 % intervals", "", [one for one in twins if not one.harmless]),
        share("right model: no answer (exit 1 or 2, time out)", "", twins, lambda one: one.exit_code not in (0, 3)),
    ]


def _covered(what: str, bar: str, of: Iterable[Judged]) -> dict[str, Any]:
    kept = [one for one in of if one.said != "wrong_model"]
    counted = sum(one.counted for one in kept)
    hits = sum(one.covered for one in kept)
    return _row(what, bar, hits / counted if counted else None, f"{hits} of {counted} in {len(kept)} studies")


def _row(what: str, bar: str, figure: float | None, detail: str) -> dict[str, Any]:
    sign, _, limit = bar.partition(" ")
    met = None
    if bar and figure is not None:
        met = figure >= float(limit) if sign == ">=" else figure <= float(limit)
    return {"what": what, "bar": bar, "figure": figure, "met": met, "detail": detail}


def by_kind(rows: Sequence[Judged]) -> list[str]:
    """One line a kind of single fault: cases, confidently wrong, cause first, among three."""
    kinds = sorted({one.faults[0].split()[0] for one in rows if len(one.faults) == 1})
    made = []
    for kind in kinds:
        own = [one for one in rows if len(one.faults) == 1 and one.faults[0].split()[0] == kind]
        first, three = (sum(one.ranks[0] is not None and one.ranks[0] <= n for one in own) for n in (1, 3))
        wrong = sum(one.confidently_wrong for one in own)
        made.append(
            f"  {kind:16s} {len(own):3d} studies, confidently wrong {wrong:2d}, cause first {first:2d}, in three {three:2d}"
        )
    return made


def as_json(rows: Sequence[Judged]) -> dict[str, Any]:
    """What --out/results.json holds."""
    return {"summary": summary(rows), "studies": [asdict(one) for one in rows]}
