"""Items requested as one range: small requests would wait for round trips on a fast link."""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

from gsynopsis.stream.catalog import Catalog, Key

RUN = 0.05
"""Items side by side in the file are asked for as one if together they take no longer, seconds
(ours: more would come before its turn)."""
ENDING, ENDING_RUN = 0.5, 0.1
"""Seconds left of the stream below which requests grow longer, and their length, seconds (ours).

The order matters less than round trips then, so requests leave no gaps.
"""


def coalesce(catalog: Catalog, key: Key, known: AbstractSet[Key], rate: float) -> tuple[Key, ...]:
    """An item, and its neighbours in the file that come in no time along with it.

    Those behind it; in the end also those before it, lest they be small requests of their own.

    Args:
        catalog: What there is.
        key: The item; it lacks.
        known: Items that are held or asked for.
        rate: Throughput, bytes per second; 0 where only the item itself may be asked for.

    Returns:
        Items that lie side by side, in the order of the file.
    """
    lacks = sum(item.size for other, item in catalog.items.items() if other not in known)
    ending = lacks <= ENDING * rate
    room = rate * (ENDING_RUN if ending else RUN) - catalog.items[key].size
    # Items without bytes lie nowhere.
    order = [other for other, item in catalog.items.items() if item.size or other == key]
    place = order.index(key)
    run = [key]
    for side, ahead in ((order[place + 1 :], True), (order[:place][::-1], False)):
        if not (ahead or ending):
            break
        for other in side:
            size = catalog.items[other].size
            if other in known or size > room or not _adjoin(catalog, run, other):
                break
            room -= size
            run = [*run, other] if ahead else [other, *run]
    return tuple(run)


def _adjoin(catalog: Catalog, run: Sequence[Key], other: Key) -> bool:
    """True if an item lies right behind or right before others that lie side by side."""
    start, stop = catalog.items[run[0]].start, catalog.items[run[-1]].stop
    return catalog.items[other].start == stop or catalog.items[other].stop == start
