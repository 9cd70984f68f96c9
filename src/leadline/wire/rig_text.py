"""The rig as the content of an attachment, by way of its file."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from leadline.errors import InputError
from leadline.rig import Rig


def rig_to_text(rig: Rig) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.yaml"
        rig.save(path)
        return path.read_bytes()


def rig_from_text(content: bytes, where: str) -> Rig:
    """Raises InputError, naming ``where`` in place of the temporary file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.yaml"
        path.write_bytes(content)
        try:
            return Rig.load(path)
        except InputError as error:
            raise InputError(error.what, error.where.replace(str(path), where), error.fix) from None
