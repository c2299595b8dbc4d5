"""The dissertation's tables and figures, computed beside the printed numbers: one module a chapter."""
