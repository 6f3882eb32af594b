"""A run's folder: documents and frames written as they come, readable after a crash, read back with
json and h5py alone.

``documents.jsonl`` holds event-model documents, ``{"name": ..., "doc": ...}`` on a line each;
``frames.h5`` holds one dataset ``frames`` of shape (n, rows, columns); ``SHA256SUMS`` the sums of
the other files.
"""

from flflab.record.checksums import checksum
from flflab.record.folder import (
    claim_folder,
    forget_descriptions,
    keep_descriptions,
    new_folder,
    run_folder,
    versions,
)
from flflab.record.frame_record import AccuracyRecord, FrameRecord, Validity
from flflab.record.nexus import export_nexus
from flflab.record.packing import pack
from flflab.record.reading import (
    ELEMENTS,
    Run,
    read_documents,
    read_run,
    world_key,
)
from flflab.record.validity import RECORD_SCHEMA, TEMPERATURES, frames_said, not_used
from flflab.record.writing import ContinuedRecording, Recording

__all__ = [
    "ELEMENTS", "RECORD_SCHEMA", "TEMPERATURES", "AccuracyRecord", "ContinuedRecording",
    "FrameRecord", "Recording", "Run", "Validity", "checksum", "claim_folder", "export_nexus",
    "forget_descriptions", "frames_said", "keep_descriptions", "new_folder", "not_used", "pack",
    "read_documents", "read_run", "run_folder", "versions", "world_key",
]  # fmt: skip
