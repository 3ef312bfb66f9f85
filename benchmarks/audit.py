"""Known weaknesses of the locked dependencies, by pip-audit.

python benchmarks/audit.py [LOCK]

Needs the index's list of weaknesses. Without it nothing is known, which is said and is no failure;
the exit code is 1 only if there are weaknesses.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

LOCK = Path(__file__).parents[1] / "requirements-dev.lock"


def audited(lock: Path) -> tuple[list[dict[str, Any]], str]:
    """What pip-audit says of every package, and why if it says nothing."""
    command = [sys.executable, "-m", "pip_audit", "--format", "json", "--progress-spinner", "off"]
    try:
        done = subprocess.run(
            [*command, "--disable-pip", "--require-hashes", "-r", str(lock)],
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        return json.loads(done.stdout)["dependencies"], done.stderr
    except subprocess.TimeoutExpired:
        return [], "no answer within 300 s"
    except (ValueError, KeyError):
        return [], done.stderr.strip() or "pip-audit said nothing"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("lock", nargs="?", type=Path, default=LOCK)
    lock = parser.parse_args().lock
    packages, why = audited(lock)
    known = [p for p in packages if "vulns" in p]
    skipped = [p for p in packages if "vulns" not in p]
    if not known:
        why = skipped[0]["skip_reason"] if skipped else (why.splitlines() or ["?"])[-1]
        print(f"NOTHING WAS AUDITED of {lock.name}: the list of weaknesses was not reached ({why})")
        return 0
    weak = [p for p in known if p["vulns"]]
    for package in weak:
        for weakness in package["vulns"]:
            fixed = ", ".join(weakness["fix_versions"]) or "no version yet"
            print(f"{package['name']} {package['version']}: {weakness['id']}, fixed in {fixed}")
    print(f"{len(known)} packages audited, {len(weak)} with known weaknesses")
    if skipped:
        print(f"{len(skipped)} NOT audited: {', '.join(p['name'] for p in skipped)}")
    return 1 if weak else 0


if __name__ == "__main__":
    sys.exit(main())
