"""The measured frame, identified without one of its sensors: is the FRF of that sensor inside the band that is predicted?

python benchmarks/accuracy/left_out_sensors.py [--sensors 401X+ 302X+] [--draws 200]
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.prediction.predict import predict
from structid.prediction.quantities import Frf
from structid.study.run.run import run_study
from structid.study.schema.study import load_study

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "three_storey_frame"
OUTPUTS = ("103X-", "401X+", "301X+", "201X+", "101X+", "402X+", "302X+", "202X+", "102X+")
#: Those that may be left out: 101X+ and 102X+ tell how far the friction of the rails slides.
SENSORS = ("401X+", "301X+", "201X+", "402X+", "302X+", "202X+")
BAND = (18.0, 85.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="+", default=list(SENSORS), choices=SENSORS)
    parser.add_argument("--draws", type=int, default=200)
    chosen = parser.parse_args()
    options = sid.ReadOptions(
        array="accelerance", frequency_array="freq_hz", kind="accelerance", outputs=OUTPUTS, inputs=("103X+",)
    )
    record = sid.read_record(EXAMPLE / "frf.npz", options).band(*BAND)
    print("left out  inside %  half-width %  error %  (medians of the magnitude over the lines from 18 to 85 Hz)")
    shares = []
    for sensor in chosen.sensors:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "frame"
            shutil.copytree(EXAMPLE, folder)
            used = ", ".join(f'"{output}"' for output in OUTPUTS if output != sensor)
            text = (folder / "study.toml").read_text(encoding="utf-8")
            line = 'inputs = ["103X+"]\n'
            (folder / "study.toml").write_text(
                text.replace(line, f"{line}channels_used = [{used}]\n"), encoding="utf-8"
            )
            found = run_study(load_study(folder / "study.toml")).identification
        told = predict(found, Frf([sensor], ["103X+"], record.frequency), n_draws=chosen.draws)
        measured = np.abs(record.values[:, OUTPUTS.index(sensor), 0])
        low, high, value = told.low[:, 0, 0], told.high[:, 0, 0], np.abs(told.values[:, 0, 0])
        inside = float(((low <= measured) & (measured <= high)).mean())
        shares.append(inside)
        width, error = np.median((high - low) / 2 / value), np.median(np.abs(measured / value - 1))
        print(f"{sensor:8s}  {100 * inside:8.1f}  {100 * width:12.1f}  {100 * error:7.1f}", flush=True)
    print(f"all       {100 * np.mean(shares):8.1f}")


if __name__ == "__main__":
    main()
