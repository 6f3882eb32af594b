"""The descriptions of a bench and a study beside a record: those it was taken with."""

from pathlib import Path

from flflab.bench import Bench, read_bench
from flflab.errors import FlflabError, RecordError
from flflab.record import Recording, forget_descriptions, keep_descriptions
from flflab.study import Study, read_study


def with_descriptions(
    recording: Recording, bench: Bench, study_file: Path | None, study: Study | None = None
) -> Recording:
    """A record with the descriptions beside it: written when the folder is its own, so that no
    other run's are written over.

    Raises:
        RecordError: the folder cannot be written, or a file is no longer what was read of it;
            nothing is left in the folder.
    """
    folder = recording.folder
    try:
        keep_descriptions(folder, bench, study_file)
        kept = read_bench(folder / "bench.yaml")
        same = kept.optics == bench.optics and kept.description == bench.description.model_copy(
            update={"optics": "camera.yaml"}
        )
        if not same or (
            study is not None and read_study(folder / "study.yaml", kept.optics) != study
        ):
            changed = bench.file if study is None else f"{bench.file} or {study_file}"
            raise RecordError(
                f"{folder}: {changed} was changed while the bench was connected; nothing moved,"
                " begin again"
            )
    except FlflabError:
        forget_descriptions(folder)
        recording.discard()
        raise
    return recording
