"""The command `structid predict`: what an identified model says of other places, other loads and a changed structure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from structid.cli.base import Png, Report, beside_call, check_png, results_folder, say
from structid.core.errors import InputError
from structid.prediction.options import PredictOptions

if TYPE_CHECKING:
    from structid.prediction.changes import Change

Results = Annotated[Path, typer.Argument(metavar="RESULTS", help="Results folder of `structid identify`.")]
StudyOption = Annotated[
    Path | None, typer.Option("--study", metavar="STUDY.toml", help="The study, where it has moved since.")
]


def predict(
    results: Results,
    options: PredictOptions,
    mass: Annotated[list[str] | None, typer.Option(metavar="KG@NODE", help="A mass that is added: 5@12.")] = None,
    scale: Annotated[
        list[str] | None, typer.Option(metavar="PROPERTY=FACTOR", help="As in bending_stiffness[deck]=1.2.")
    ] = None,
    damper: Annotated[
        list[str] | None,
        typer.Option(metavar="KG,HZ,RATIO@DOF", help="A tuned mass damper: mass, frequency, damping ratio, place."),
    ] = None,
    support: Annotated[list[str] | None, typer.Option(metavar="DOF", help="A degree of freedom that is held.")] = None,
    remove: Annotated[list[str] | None, typer.Option(metavar="SET", help="An element set that is taken out.")] = None,
    study: StudyOption = None,
    out: Annotated[Path | None, results_folder("<results>_prediction")] = None,
    report: Report = True,
    png: Png = False,
) -> None:
    """Predict FRFs, motion, stresses and modes of an identified or a changed model, with bands; write prediction.json and a page.

    Bands hold 95 %. They include the uncertainty of the parameters, tolerances, and of responses what the fit missed beyond noise.
    With changes, values before and after are written, and the difference, in which shared errors cancel.

    \b
    Examples:
      structid predict frame_results --sensors 401X+,301X+
      structid predict frame_results --sensors 401X+ --loads 103X+ --band 5 90 --kind receptance
      structid predict bridge_results --sensors 12Y --history push.csv --motion displacement
      structid predict bridge_results --sensors "M[deck:3@12],stress[deck:3@12 y=0.4 E=2.1e11]" --history push.csv
      structid predict tower_results --sensors 40X --history quake.csv --relative --motion displacement
      structid predict tower_results --sensors 40X --noise wind.csv@40X --duration 600
      structid predict bridge_results --sensors 12Y --mass 500@12 --scale "bending_stiffness[deck]=1.1"
      structid predict tower_results --participation X,Y --modes 12
      structid predict tower_results --sensors 40X --damper 800,0.62,0.12@40X
      structid predict tower_results --sensors 40X --tune-damper 800@40X
    """
    from structid.cli.console import show  # the help needs none of these
    from structid.core.json_types import json_text
    from structid.report.prediction import prediction_page, prediction_text
    from structid.study.results.folder import staged_folder
    from structid.study.run.predicting import PREDICTION_PAGE, predict_study, prediction_csv, prediction_summary

    check_png(report, png)
    changes = _changes(mass or (), scale or (), damper or (), support or (), remove or ())
    prediction = predict_study(results, options, changes, study)
    folder, name = out if out is not None else beside_call(f"{results.name}_prediction"), "prediction.json"
    with staged_folder(folder, name, PREDICTION_PAGE) as staged:
        (staged / name).write_text(json_text(prediction_summary(prediction)), encoding="utf-8")
        for quantity, part in (
            ("frf", prediction.frf),
            ("history", prediction.history),
            ("spectrum", prediction.spectrum),
        ):
            if part is not None:
                (staged / f"{quantity}.csv").write_text(prediction_csv(part), encoding="utf-8")
        if report:
            name = prediction_page(prediction).write(staged, png).name
    show(prediction_text(prediction))
    say(folder / name)


def _changes(
    masses: list[str] | tuple[()],
    scales: list[str] | tuple[()],
    dampers: list[str] | tuple[()],
    supports: list[str] | tuple[()],
    removed: list[str] | tuple[()],
) -> list[Change]:
    """Changes of the structure from the texts of the flags; raises `InputError` if a text has another form.

    Masses are ``KG@NODE``, scales ``PROPERTY=FACTOR``, dampers ``KG,HZ,RATIO@DOF``; `supports` name degrees of freedom,
    `removed` element sets.
    """
    from structid.core.dof import is_whole_number
    from structid.prediction.changes import AddMass, AddSupport, AddTunedMassDamper, Remove, Scale

    changes: list[Change] = []
    for text in masses:
        kg, at, node = text.partition("@")
        if not (at and is_whole_number(node)):
            raise InputError(f"--mass must be a mass and a node, as 5@12, got {text!r}")
        changes.append(AddMass(int(node), _number("--mass", kg)))
    for text in scales:
        label, equals, factor = text.rpartition("=")
        if not equals:
            raise InputError(f"--scale must be a property and a factor, as bending_stiffness[deck]=1.2, got {text!r}")
        changes.append(Scale(label.strip(), _number("--scale", factor)))
    for text in dampers:
        sizes, at, dof = text.partition("@")
        numbers = sizes.split(",")
        if not at or len(numbers) != 3:
            raise InputError(f"--damper must be kg, Hz, damping ratio and a place, as 800,0.62,0.12@40X, got {text!r}")
        changes.append(AddTunedMassDamper(dof, *(_number("--damper", number) for number in numbers)))
    changes += [AddSupport(dof) for dof in supports]
    changes += [Remove(name) for name in removed]
    return changes


def _number(flag: str, text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise InputError(f"{flag} must hold numbers, got {text!r}") from error
