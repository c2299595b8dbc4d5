"""`python -m structid`, the same as the command `structid`."""

from structid.cli import main

main()
