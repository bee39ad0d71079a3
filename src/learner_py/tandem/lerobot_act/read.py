"""Reading a checkpoint's JSON, with a sentence when it can't be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tandem.policy_file import PolicyFileError


def read_json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text())
    except OSError as error:
        raise PolicyFileError(
            f"{path} can't be read ({error.strerror}); give the folder of a LeRobot checkpoint (pretrained_model)."
        ) from None
    except ValueError as error:
        raise PolicyFileError(f"{path} is not JSON: {error}.") from None
    if not isinstance(value, dict):
        raise PolicyFileError(f"{path} is not a JSON object.")
    return value
