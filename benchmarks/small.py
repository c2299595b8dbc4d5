"""Every benchmark at a size of seconds, so that none rots: that it runs is checked, its figures are not.

    python benchmarks/small.py [NAME ...]

Each script of this folder and of `accuracy` has a line in `SMALL`, or in `NOT_RUN` with the reason. A script fails where
it ends in an error; an exit code of 1 is a missed bar, which small sizes and busy machines do not tell. The exit code is
the number of scripts that failed.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
DATA = FOLDER.parent.parent / "shared" / "data"
TIMEOUT = 300.0
#: The arguments of each script at its small size; {folder} is a folder of its own, {data} that of measured records.
SMALL: dict[str, str] = {
    "arrow_system.py": "--counts 1",
    "cluster.py": "--quick --size 3 --lines 4 --repeats 4 --medians 1 --gigabytes 0.002",
    "component.py": "--cells 8 --up-to 100 --rounds 1",
    "frequency_domain.py": "--tiny --quick --repeats 1",
    "frequency_domain_end_to_end.py": "solid --shape 10 4 6 --lines 6 --iterations 2 --folder {folder}/solid",
    "gauss_newton_step.py": "",
    "matrix_files.py": "--entries 20000",
    "modal_scale.py": "--tiny --quick",
    "prediction_speed.py": "--size 6 --lines 40 --outputs 4 --draws 50 --large 12",
    "small_jobs.py": "gantry --small --rounds 1",
    "plate_damage.py": "--out {folder}/plate --shape 8 4 --lines 6 --sensors 6",
    "scaling.py": "--out {folder}/scaling --quick --only frf_frequencies --points 2",
    "time_domain.py": "--quick --repeats 1 --only merged",
    "time_domain_beside.py": "{src} --repeats 1 --only exact",
    "time_domain_chain.py": "--elements 50 --gigabytes 0.002",
    "correlation.py": "",
    "accuracy/base_motion.py": "--repeats 3",
    "accuracy/broad_band.py": "run --case cantilever --rms 20 --lines 400 --repeats 1 --out {folder}/broad",
    "accuracy/chapter_4_basins.py": "--repeats 1 --row 0 --uniqueness-starts 2",
    "accuracy/damage.py": "--repeats 1 --undamaged 1 --out {folder}/damage.jsonl",
    "accuracy/damped_decays.py": "--repeats 1",
    "accuracy/errors_in_common.py": "--repeats 1 --right 2",
    "accuracy/expanded_shapes.py": "--repeats 2 --nodes 8 5",
    "accuracy/frame_models.py": "--rows 1",
    "accuracy/frames_of_frequencies.py": "--repeats 2",
    "accuracy/frame_shape_noise.py": "--seeds 1 --pieces 2",
    "accuracy/frame_twin.py": "--repeats 1 --stride 20 --workers 1",
    "accuracy/free_beam_time.py": "--repeats 1 --samples 200",
    "accuracy/frf_modes.py": "--kinds 0 --repeats 0 --beyond 1 --rows 1",
    "accuracy/garteur.py": "--variants 1",
    "accuracy/held_values.py": "--repeats 2",
    "accuracy/iasc_asce.py": "{data}/iasc_asce_phase_1 --cases 1 --patterns 0 --samples 2001",
    "accuracy/iasc_asce_frame.py": "--only c1_p0",
    "accuracy/interval_coverage.py": "--repeats 2 --only component ground",
    "accuracy/mesh_pieces.py": "--repeats 1",
    "accuracy/merged_setups.py": "--repeats 1 --duration 120",
    "accuracy/merging_campaigns.py": "--campaigns 1",
    "accuracy/noise_floor.py": "--repeats 1",
    "accuracy/modal_noise.py": "--repeats 1 --decays 4 --ambient 2",
    "accuracy/planned_test.py": "--repeats 1 --candidates 6 --parts a",
    "accuracy/roller_place.py": "--repeats 3",
    "accuracy/shaker_force.py": "--repeats 1 --samples 400",
    "accuracy/shells.py": "--finest 4",
    "accuracy/left_out_sensors.py": "--sensors 401X+ --draws 50",
    "accuracy/predictions.py": "--repeats 1 --only chain",
    "accuracy/virtual_sensing.py": "--repeats 1 --samples 300",
    "accuracy/bridge_traffic.py": "--repeats 1 --seconds 2 --forces seven",
    "accuracy/sensing_verdict.py": "--right 1 --wrong 1 --samples 200",
    "accuracy/short_records.py": "--repeats 1",
    "accuracy/sierra_blocks.py": "--corners 1",
    "accuracy/six_masses.py": "--arrangements 4 --short",
    "accuracy/six_masses_frf.py": "--arrangements 1",
    "accuracy/merging_records.py": "--campaigns 1",
    "accuracy/stored_correlations.py": "--repeats 1",
    "accuracy/six_masses_predicted.py": "--arrangements 4",
    "accuracy/six_masses_varying.py": "--arrangements 4 --choices nothing",
    "accuracy/spectral_modes.py": "--repeats 1",
    "accuracy/tie_rod.py": "--repeats 20 --holds",
    "accuracy/tolerances.py": "--repeats 1 --tolerance 0.02 --only chain/frf",
    "accuracy/tolerances_elsewhere.py": "--repeats 1 --tolerance 0.02 --only mast/frf",
    "accuracy/translations_only.py": "--elements 9 --repeats 1",
    "accuracy/varying_records.py": "--repeats 1 --setups 4",
    "accuracy/wrong_models.py": "--set development --only two_span-frf-near-mass-6",
    "accuracy/bands.py": "--bridges 1",
    "accuracy/damping_of_two_programs.py": "--records 1",
    "accuracy/light_damping.py": "--records 2 --seconds 100",
    "accuracy/tones_beside_modes.py": "--records 1 --seconds 120",
    "accuracy/mode_probability.py": "--records 8",
    "accuracy/moving_roller.py": "--decays 2",
}
#: Scripts that read measurements or matrices beside the project, and are skipped where that folder is missing.
READS_DATA = frozenset(
    {
        "small_jobs.py",
        "accuracy/errors_in_common.py",
        "accuracy/frf_modes.py",
        "accuracy/iasc_asce.py",
        "accuracy/iasc_asce_frame.py",
        "accuracy/sierra_blocks.py",
        "accuracy/six_masses.py",
        "accuracy/six_masses_frf.py",
        "accuracy/six_masses_predicted.py",
        "accuracy/six_masses_varying.py",
    }
)
#: Scripts that CI cannot run, with the reason.
NOT_RUN: dict[str, str] = {
    "all.py": "runs other scripts of this folder",
    "small.py": "this script",
    "against_pyoma2.py": "installs a peer in an environment of its own",
    "cluster_end_to_end.py": "starts a cluster and identifies the measured frame twice, some minutes",
    "first_hour.py": "needs a browser; the tours of the report in the tests do as well",
    "scaling_cases.py": "is started by scaling.py",
    "workbench.py": "needs a browser; the tours of the workbench in the tests do as well",
    "accuracy/hex_blocks.py": "needs the files of a solver, which are not part of the project",
    "accuracy/iasc_asce_studies.py": "identifies the studies of the benchmark building, some minutes each",
}


def main(names: list[str]) -> int:
    """Run the scripts named, all by default, print a line for each, and return how many failed."""
    names = names or list(SMALL)
    for name in names:
        if name not in SMALL:
            print(f"{name}: {NOT_RUN.get(name, 'there is no such benchmark')}")
            return 1
    failed = [name for name in names if not run_script(name)]
    print(f"{len(names) - len(failed)} of {len(names)} benchmarks run" + "".join(f"; {n} failed" for n in failed))
    return len(failed)


def run_script(name: str) -> bool:
    """Run one script at its small size and return False where it ends in an error."""
    with tempfile.TemporaryDirectory() as folder:
        words = SMALL[name].format(folder=folder, data=DATA, src=FOLDER.parent / "src").split()
        if name in READS_DATA and not DATA.is_dir():
            print(f"skipped  {name}: the measurements and matrices of {DATA} are not here")
            return True
        before = processor_seconds()
        try:
            done = subprocess.run(
                [sys.executable, str(FOLDER / name), *words],
                cwd=folder, env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"},
                capture_output=True, text=True, timeout=TIMEOUT, check=False,
            )  # fmt: skip
            is_fine = done.returncode == 0 or (done.returncode == 1 and not done.stderr.strip())
            last = done.stderr.strip()
        except subprocess.TimeoutExpired:
            is_fine, last = False, f"took more than {TIMEOUT:g} s"
    print(f"{'runs   ' if is_fine else 'FAILED '}  {name}  {processor_seconds() - before:.1f} s", flush=True)
    if not is_fine:
        print("         " + "\n         ".join(last.splitlines()[-4:]))
    return is_fine


def processor_seconds() -> float:
    """Processor time of all scripts that have ended, and of what they started."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
