"""Two states of a structure compared: read or run, tested, and what the reader should know first."""
