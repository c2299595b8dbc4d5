"""Studies whose model or record is wrong in a known way: does structid say so, name the cause, and never trust them?

The simulator beside this file shares no code with structid. See wrong_models/README.md.

    python benchmarks/accuracy/wrong_models.py [--set development|heldout|fresh] [--only NAME ...] [--jobs 1] [--out FOLDER]
"""

from wrong_models.running import main

if __name__ == "__main__":
    raise SystemExit(main())
