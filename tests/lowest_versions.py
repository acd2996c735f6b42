"""Prints the lowest versions that pyproject.toml allows, as constraints for pip."""

import re
import sys
import tomllib
from pathlib import Path


def lowest(path: Path) -> list[str]:
    """`name==version` of every `name>=version` among dependencies and extras but `dev`, `fuzz`."""
    project = tomllib.loads(path.read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = list(project["dependencies"])
    for name, needs in extras.items():
        wanted += needs if name not in ("dev", "fuzz") else []
    found = [re.fullmatch(r"([A-Za-z0-9_.-]+)(?:\[[^]]*\])?>=([0-9.]+).*", need) for need in wanted]
    return sorted(f"{m[1]}=={m[2]}.*" for m in found if m)


if __name__ == "__main__":
    sys.stdout.write("\n".join(lowest(Path(sys.argv[1]))) + "\n")
