"""All commands of ``flflab`` in one list; each lives in the file of its name."""

import typer

from flflab.cli import bench, compare, image, measure, model, new, plan, sim, validate

app = typer.Typer(
    name="flflab",
    help="Run the bench of a focused light field camera and say, with numbers, whether the camera does what its model says.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("validate")(validate.validate)
app.command("compare")(compare.compare)
app.command("model")(model.model)
app.command("image")(image.image)
app.command("measure")(measure.measure)
app.command("plan")(plan.plan)
app.add_typer(bench.app, name="bench")
app.command("sim")(sim.sim)
app.command("report")(validate.report)
app.command("new")(new.new)
