"""Repeats of one measurement must be alike; where they are not, what differs is said."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from structid.core.display import join_words
from structid.core.errors import InputError


def require_shared(name: str, values: Sequence[Sequence[Hashable]], sources: Sequence[str]) -> None:
    """Raise `InputError` if a repeat differs from the first in `values`, also in their order.

    Parameters
    ----------
    name : str
        Description of the values, for the message.
    values : sequence of sequences
        Values of each repeat.
    sources : sequence of str
        Name of each repeat, for the message; "" if not known.

    Raises
    ------
    InputError
        If a repeat differs; the message says which values only one of both has.
    """
    for i, own in enumerate(values):
        if list(own) == list(values[0]):
            continue
        both = set(values[0]) & set(own)
        more, other = ([one for one in given if one not in both] for given in (values[0], own))
        pair = [f"repeat {j + 1}" + (f" ({sources[j]})" if sources[j] else "") for j in (0, i)]
        if other and not more:
            pair, more, other = pair[::-1], other, more
        words = f"{_listed(more)}, where {pair[1]} has {_listed(other) or 'none'}" if more else "another order"
        raise InputError(
            f"repeated records must share {name}: {pair[0]} has {words}; leave out what differs, or give each as a record of"
            " its own"
        )


def _listed(items: Sequence[Hashable]) -> str:
    return join_words([f"{one:.12g}" if isinstance(one, float) else one for one in items])
