"""Start times good to a few milliseconds, before anything is known of the cameras: enough to lay frames beside each other."""

from __future__ import annotations

from collections.abc import Mapping

from headcap.errors import InputError, InputErrors
from headcap.recordings.takes import IngestedTake
from headcap.sync.board_sound import read_sounds
from headcap.sync.settings import SyncSettings
from headcap.sync.solve import synchronise


def rough_start_s(
    take: IngestedTake, manual_start_s: Mapping[str, float] | None = None, settings: SyncSettings | None = None
) -> dict[str, float] | None:
    """Common time of each camera's own zero by the clap's sound or by hand; None where neither tells.

    The clap's time of flight stays in (3 ms per metre), and each camera's own lag of sound behind picture.
    """
    try:
        found = synchronise(read_sounds(take), take=take.take, manual_start_s=manual_start_s, settings=settings).offsets
    except (InputError, InputErrors):
        return None
    return dict(zip(found.cameras, found.start_s, strict=True))
