"""Plan and report of a training, printed."""

from pathlib import Path
from typing import TYPE_CHECKING

from gsynopsis.config import Recipe

if TYPE_CHECKING:
    from gsynopsis.evaluation.report import Report
    from gsynopsis.training.context import TrainContext


def print_plan(context: "TrainContext", recipe: Recipe) -> None:
    """The plan as one JSON object on stderr."""
    import json
    import sys
    from dataclasses import asdict

    from gsynopsis.resources.report import plan_of

    plan, account = asdict(plan_of(context)), context.scene.account.document()
    event = {"event": "plan", **plan, "account": account, "settings": recipe.lines()}
    print(json.dumps(event), file=sys.stderr, flush=True)


def print_report(report: "Report | None", out: Path, *, as_json: bool) -> None:
    """The table of levels and where the report is, or its JSON; nothing if there is none."""
    if report is None:
        return
    from gsynopsis.evaluation.report import report_json, report_table
    from gsynopsis.evaluation.report_files import names_of

    if as_json:
        print(report_json(report), end="")
        return
    print(report_table(report))
    print("\n".join(map(str, names_of(out))))
