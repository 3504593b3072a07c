"""Ingest's checks of a whole session, without running anything."""

from headcap.errors import InputError, InputErrors
from headcap.recordings.takes import IngestedTake, check_same_cameras, freezes_of, ingest_take
from headcap.settings import CALIBRATION, Session
from headcap.sync.rough import rough_start_s


def check_recordings(session: Session) -> str:
    """Probe every recording of a session; returns one line that sums up, raises `InputErrors` with all that is wrong."""
    if session.rehearse is not None:
        return "its recordings are rendered when it runs"
    ingested, errors = [], []
    for name in (CALIBRATION, *(take.name for take in session.takes)):
        try:
            ingested.append(ingest_recording(session, name))
        except InputErrors as error:
            errors += error.errors
        except InputError as error:
            errors.append(error)
    try:
        check_same_cameras(ingested)
    except InputErrors as error:
        errors += error.errors
    for take in ingested:
        start_s = rough_start_s(take, session.recorded(take.take).offsets_s, session.sync)
        errors += freezes_of(take, session.ingest, start_s=start_s)
    if errors:
        raise InputErrors(errors)
    frames = sum(len(recording.frame_times_s) for take in ingested for recording in take.recordings)
    return f"{len(session.cameras)} cameras, {len(session.takes)} takes, {frames} frames: all usable"


def ingest_recording(session: Session, name: str) -> IngestedTake:
    """Ingest one take, or the board's recording, as the session describes it."""
    recorded = session.recorded(name)
    frames = getattr(recorded, "frames", None)
    return ingest_take(
        name,
        getattr(recorded, "kind", "board"),
        session.recordings(name),
        rate_hz=session.rate_hz,
        needs_sound=recorded.clap,
        min_frames=frames[1] + 1 if frames else None,
        settings=session.ingest,
    )
