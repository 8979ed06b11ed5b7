"""The JSON schema of a scene file, for editors; on file, as the models take long to import.

After a change of the models ``python -m simbench.scenario.schema`` writes it anew.
"""

import json
from pathlib import Path

PATH = Path(__file__).with_name("schema.json")


def text() -> str:
    """The schema as it was written last."""
    return PATH.read_text(encoding="utf-8")


def generated() -> str:
    """The schema of the models as they are."""
    from simbench.scenario import Scenario

    return json.dumps(Scenario.json_schema(), indent=2) + "\n"


if __name__ == "__main__":
    PATH.write_text(generated(), encoding="utf-8")
