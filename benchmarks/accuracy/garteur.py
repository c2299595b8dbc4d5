"""GARTEUR SM-AG19 aeroplane: beams of the published geometry before and after updating, beside the eight published frequencies.

    python benchmarks/accuracy/garteur.py

The study is `examples/garteur_aeroplane`. Before: the wing bare, and with its constraining layer bonded without slip; joints stiff.
After: bending and torsion of the wing and three joints from the eight frequencies. Further rows say how far what was assumed
moves the answer: the error of the model, the mass that the drawing lacks, and each joint held stiff.

Sources: Gravelle (1999), GARTEUR TP-115; Balmes and Wright (1997), IMAC 15, 1346-1352. Geometry as in Krysl's open teaching
model.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import re
import shutil
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import structid as sid
from structid.compare.correlation import correlate

STUDY = Path(__file__).parents[2] / "examples" / "garteur_aeroplane" / "study.toml"
NAMES = {
    6.38: "wing two-node bending",
    16.10: "fuselage rotation",
    33.12: "antisymmetric wing torsion",
    33.53: "symmetric wing torsion",
    35.65: "wing three-node bending",
    48.38: "wing four-node bending",
    49.43: "in-plane wing",
    55.08: "symmetric in-plane wing",
}
#: Bending (N m^2, upwards) and torsional stiffness of the wing, bare and with the layer bonded without slip.
BARE, BONDED = (600.0, 864.92), (822.523, 1199.17)
PUBLISHED_MASS = 44.0  # kg, about
#: Lines of the study that a variant writes instead.
FUSELAGE = "mass = 20.25\npolar_inertia = 0.0421875"


@dataclass(frozen=True)
class Variant:
    """One way to run the study.

    Attributes
    ----------
    name : str
    lines : dict of str to str
        What is written instead of what.
    held : tuple of str
        Sets whose unknown is left out, at its value in the study.
    """

    name: str
    lines: dict[str, str]
    held: tuple[str, ...] = ()


def layer(bending: float, torsion: float) -> dict[str, str]:
    """The wing's stiffnesses instead of those of the study."""
    return {
        "bending_stiffness_y = 822.523": f"bending_stiffness_y = {bending}",
        "torsional_stiffness = 1199.17": f"torsional_stiffness = {torsion}",
    }


STIFF = {"stiffness = 4e4": "stiffness = 1e7", "stiffness = 1e6": "stiffness = 1e7"}
BEFORE = (Variant("bare wing", {**STIFF, **layer(*BARE)}), Variant("layer bonded", STIFF))
AFTER = (
    Variant("updated", {}),
    Variant("joints start 25 times stiffer", {"stiffness = 4e4": "stiffness = 1e6"}),
    Variant("model errs by 1 %", {"frequency_error = 0.005": "frequency_error = 0.01"}),
    Variant("1.9 kg more on the fuselage", {FUSELAGE: "mass = 21.536\npolar_inertia = 0.044867"}),
    Variant("yaw at the root held stiff", {}, ("yaw at the root",)),
    Variant("roll at the root held stiff", {}, ("roll at the root",)),
    Variant("roll of the fin held stiff", {}, ("roll of the fin",)),
)


def study_of(variant: Variant, folder: Path) -> sid.Study:
    """The study as `variant` has it, in `folder`."""
    shutil.copytree(STUDY.parent, folder, dirs_exist_ok=True)
    text = STUDY.read_text(encoding="utf-8")
    for was, now in variant.lines.items():
        if was not in text:
            raise ValueError(f"{STUDY}: holds no {was!r}; correct the variant {variant.name!r}")
        text = text.replace(was, now)
    for held in variant.held:
        text, count = re.subn(rf'\[\[unknown\]\]\nproperty = "\w+"\nelements = "{held}"\n', "", text)
        stiff = re.compile(rf'(name = "{held}".*?\nstiffness = )\S+', re.DOTALL)
        text = stiff.sub(r"\g<1>1e7", text, count=1)
        if count != 1:
            raise ValueError(f"{STUDY}: seeks nothing of {held!r}; correct the variant {variant.name!r}")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return sid.load_study(folder / "study.toml")


def before(study: sid.Study) -> dict[float, tuple[float, float]]:
    """Frequency (Hz) of the model's mode that each published one is paired with at the start values, and its MAC."""
    found = {}
    for part in correlate(study).modes:
        for i, measured in enumerate(part.measured.frequency):
            k = part.pairing.number[i]
            found[float(measured)] = (
                (float(part.model.frequency[k]), float(part.pairing.mac[i, k])) if k >= 0 else (np.nan, np.nan)
            )
    return found


def after(found: sid.StudyResult) -> dict[float, tuple[float, float]]:
    """The same of the identified model."""
    return {
        float(measured): (float(frequency), float(mac))
        for fit in found.identification.modal_fits
        for measured, frequency, mac in zip(fit.measured.frequency, fit.fitted.frequency, fit.fitted.mac, strict=True)
    }


def shares(found: sid.StudyResult) -> list[tuple[float, float]]:
    """How much of what a layer without slip would add to bending and torsion of the wing was found, and its deviation."""
    names = ("bending_stiffness_y[wing]", "torsional_stiffness[wing]")
    got = []
    for name, bare, bonded in zip(names, BARE, BONDED, strict=True):
        value, std = found.estimate[name]
        got.append(((value - bare) / (bonded - bare), std / (bonded - bare)))
    return got


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", type=int, help="the first so many updated models only")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        columns = {one.name: before(study_of(one, folder / one.name)) for one in BEFORE}
        results = {one.name: sid.run_study(study_of(one, folder / one.name)) for one in AFTER[: chosen.variants]}
    columns["updated"] = after(results["updated"])
    print(f"{'mode':<28}{'published Hz':>13}" + "".join(f"{name:>22}" for name in columns) + f"{'MAC':>7}")
    for published, name in NAMES.items():
        mac = columns["updated"][published][1]
        cells = [
            f"{one[published][0]:.2f} ({100 * (one[published][0] / published - 1):+.1f} %)" for one in columns.values()
        ]
        print(f"{name:<28}{published:>13.2f}" + "".join(f"{cell:>22}" for cell in cells) + f"{mac:>7.2f}")
    print(
        f"\nmass of the model {results['updated'].identification.mass.total:.1f} kg, published about {PUBLISHED_MASS:.0f} kg\n"
    )
    heads = (
        "layer in bending",
        "layer in torsion",
        "yaw root kN m",
        "roll root kN m",
        "roll fin kN m",
        "chi2/dof",
        "worst Hz",
    )
    print(f"{'':<30}" + "".join(f"{head:>18}" for head in heads))
    for name, found in results.items():
        cells = [f"{100 * share:.0f} ± {100 * std:.0f} %" for share, std in shares(found)]
        for place in ("yaw at the root", "roll at the root", "roll of the fin"):
            known = f"stiffness[{place}]" in found.estimate.names
            value, std = found.estimate[f"stiffness[{place}]"] if known else (np.nan, np.nan)
            cells.append(f"{value / 1e3:.4g} ± {std / 1e3:.2g}" if known else "stiff")
        worst = max(abs(frequency / published - 1) for published, (frequency, _) in after(found).items())
        cells += [f"{found.estimate.chi_square_per_dof:.2f}", f"{100 * worst:.1f} %"]
        print(f"{name:<30}" + "".join(f"{cell:>18}" for cell in cells))


if __name__ == "__main__":
    main()
