"""The stability study as files: every image, and the table of failures."""

import csv
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tactiled.study.machine import describe
from tactiled.study.pairs import Pair
from tactiled.study.silence import HEADINGS, lines, listed
from tactiled.study.stability import OURS, WORSE, Found, Row, alarms, false_warnings, limits, sound, table


def write(folder: Path, found: Found, together: Sequence[Pair], seed: int) -> None:
    """Put every image into stability.csv and stability-pairs.csv, the table into stability-table.csv.

    The table, what failed in silence and why, and the false alarms go into stability.json.
    """
    _csv(folder / "stability.csv", [_flat(row) for _, all_ in found for row in all_])
    _csv(folder / "stability-pairs.csv", [_flat(row) for pair in together for row in pair.rows])
    failures = [asdict(one) for one in table(found)]
    _csv(folder / "stability-table.csv", failures)
    told = {
        "seed": seed,
        "machine": describe(),
        "worse than raw by": WORSE,
        "sound images": len(sound(found, "auto")),
        "false warnings on auto": dict(Counter(false_warnings(found, "auto"))),
        "limits of the signs": {method: limits(found, method) for method in OURS},
        "false alarms on auto": dict(Counter(alarms(found, "auto"))),
        "silent on auto": [dict(zip(HEADINGS, line, strict=True)) for line in lines(listed(found, together))],
        "table": failures,
    }
    (folder / "stability.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


def _flat(row: Row) -> dict[str, Any]:
    told = asdict(row)
    found: dict[str, Any] = told.pop("signs")
    return told | found


def _csv(path: Path, records: list[dict[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, list(records[0]))
        out.writeheader()
        for record in records:
            out.writerow({key: _cell(value) for key, value in record.items()})


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        return " ".join(each if isinstance(each, str) else f"{each:g}" for each in value)
    return value
