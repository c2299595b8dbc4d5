"""Findings about a record: kind, channels, words with numbers and remedy, and severity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from structid.records.record import TimeRecord

Severity = Literal["note", "warning", "unusable"]
#: Kinds that say that one channel did not measure its motion.
CHANNEL_FAULTS = ("dead", "constant", "clipped", "drop_out", "spikes", "double_hit")


@dataclass(frozen=True)
class Finding:
    """One thing to know before a record is used.

    Attributes
    ----------
    kind : str
        ``dead``, ``constant``, ``clipped``, ``double_hit``, ``drop_out``, ``late_start``, ``spikes``, ``level``, ``short``,
        ``aliasing``, ``mains`` or, from `prepare`, ``filter``, from `drifts`, ``drift``.
    words : str
        What was found where, with numbers, and the remedy.
    severity : {"note", "warning", "unusable"}
        ``unusable`` means that modes or parameters from this channel would be wrong.
    channel : str
        Degree of freedom and quantity; empty where the whole record is meant.
    """

    kind: str
    words: str
    severity: Severity = "warning"
    channel: str = ""

    def __str__(self) -> str:
        return f"{self.severity}: {self.words}"


def channel_name(record: TimeRecord, index: int) -> str:
    """Degree of freedom and quantity of channel number `index`, as in ``3Z+ velocity``."""
    return f"{record.channels[index]} {record.quantities[index]}"
