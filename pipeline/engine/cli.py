"""The `polarfield` command: `all`, one command per stage, and those of `arguments.COMMANDS`."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pipeline.engine.arguments import command_parser, parse
from pipeline.engine.call import Call, describe, open_call, place_of
from pipeline.engine.changes import State, expected_warnings, keep_hint, stale_after, states
from pipeline.engine.child import run_stage
from pipeline.engine.completion import script
from pipeline.engine.costs.estimate import Estimator
from pipeline.engine.dataset import Dataset
from pipeline.engine.device import device_of, refuse_missing_cuda
from pipeline.engine.early import look_early, say_warnings
from pipeline.engine.gc import collect
from pipeline.engine.inputs_check import explained
from pipeline.engine.interrupts import Interrupted, interruptible
from pipeline.engine.outlook import outlook, plan_text, with_costs
from pipeline.engine.places import existing_dataset, refuse_another_capture
from pipeline.engine.plan import Step, load_stages, make_plan
from pipeline.engine.program import Program
from pipeline.engine.settings import remember
from pipeline.engine.verify import verify
from pipeline.errors import UserError, line_of
from pipeline.formats.dataset_files import MANIFEST

JOB_WORDS = 4  # `job PLAN ROW STAGE`: what a cluster runs of a batch's plan


def main(program: Program, arguments: Sequence[str]) -> int:
    """Run one command; a fault of input is printed as one line.

    Args:
        program: the stages and what else the command line offers.
        arguments: without the program's name.

    Returns:
        The exit status: 0 done, 1 damage found, 2 a fault of input, 128 + signal where one ended it.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a file's name may be no text
    try:
        with interruptible():
            return _run(program, arguments)
    except BrokenPipeError:
        return 0
    except (UserError, OSError, MemoryError) as error:
        print(f"polarfield: {line_of(error)}", file=sys.stderr)
        return error.status if isinstance(error, UserError) else UserError.status
    except Interrupted as signal_heard:
        if "--alone" not in arguments:  # the run that began this stage says it
            print("polarfield: interrupted; the same command goes on from what is done", file=sys.stderr)
        return signal_heard.status


def _run(program: Program, arguments: Sequence[str]) -> int:
    if arguments[:1] == ["job"] and len(arguments) == JOB_WORDS:
        from pipeline.engine.batch.plan_file import run_job

        return run_job(arguments[1:], lambda line: main(program, line))
    stages = load_stages(program.modules)
    options = parse(stages, arguments, program.formats)
    if options.command == "completion":
        print(script(options.shell, command_parser(stages, program.formats)), end="")
        return 0
    if options.command == "compare" and program.compare is not None:
        compared = [Path(p) for p in options.datasets]
        with contextlib.ExitStack() as stack:
            for path in compared:
                version = (path / MANIFEST).is_file()
                stack.enter_context(explained(Dataset.holding(path) if version else Dataset(path), stages))
            print(f"comparison: {program.compare(compared, Path(options.out))}")
        return 0
    if options.command == "export" and program.export is not None:
        dataset = existing_dataset(options.capture, options.dataset, "export")
        with explained(dataset, stages):
            print(f"exported: {program.export(dataset, options.to, options.out)}")
        return 0
    if options.command in ("gc", "verify"):
        return {"gc": collect, "verify": verify}[options.command](options, stages)
    if options.command == "batch":
        from pipeline.engine.batch.command import batch

        return batch(program, options, stages, arguments)
    call = open_call(program, options, stages)
    if options.command in ("plan", "inspect"):
        return _show(call)
    if options.command == "report":
        return _report(call)
    if options.command == "tradeoff" and program.tradeoff is not None:
        texts = call.settings.params_text(), call.settings.envs_text()
        print(f"tradeoff: {program.tradeoff(call.capture.root, call.dataset.root, *texts, call.progress.say)}")
        return 0
    call.dataset.prepare()
    with call.dataset.in_use():
        steps = make_plan(call.capture, stages, call.settings.parameters, call.capture.environments, call.dataset.digests)
        refuse_another_capture(call.dataset, call.capture, steps)
        call.dataset.digests.save(call.dataset.write_text)
        return _make_alone(call, steps) if options.alone else _bring_up_to_date(call, steps)


def _show(call: Call) -> int:
    """`plan` and `inspect`: what `all` would do; writes nothing to the dataset."""
    known = call.dataset.exists  # a capture without a dataset is not read through for a plan
    digests = call.dataset.digests if known else None
    steps = make_plan(call.capture, call.stages, call.settings.parameters, call.capture.environments, digests)
    if known:
        refuse_another_capture(call.dataset, call.capture, steps)
    found = states(call.dataset, steps)
    found = with_costs(found, Estimator(call.capture, steps, call.dataset, device_of(call.options.device)))
    print(f"{call.capture.root.name}: {call.capture.layout}\n{plan_text(steps, found)}\n{outlook(found)}")
    if hint := keep_hint(call.last, call.settings, found, call.stages, call.command not in call.stages):
        print(hint)
    warnings = expected_warnings(call.capture.warnings, call.dataset, found)
    say_warnings(warnings)
    for step in steps:
        if not found[step.stage.name].ready:
            step.stage.check(call.capture)
    new, fault = look_early(call.program.look, call.capture, steps, found, call.command, warnings)
    if call.command == "inspect":
        folder = call.dataset.root.with_name(call.dataset.root.name + "-inspect")
        told = replace(call.capture, warnings=(*call.capture.warnings, *new, *([str(fault)] if fault else [])))
        print(f"inspection: {call.program.inspect(told, steps, folder, found)}")
    if fault is not None:
        raise fault
    return 0


def _report(call: Call) -> int:
    """`report`: the metrics stage alone, of the versions in use; refuses where others would have to be made."""
    if not call.dataset.exists:
        raise UserError(call.dataset.root, "there are no results to report on yet", "`make all` makes them")
    call.dataset.prepare()
    with call.dataset.in_use():
        steps = make_plan(call.capture, call.stages, call.settings.parameters, call.capture.environments, call.dataset.digests)
        refuse_another_capture(call.dataset, call.capture, steps)
        found = states(call.dataset, steps)
        for name, state in found.items():
            if name != call.program.report and state.kind not in ("skip", "done"):
                made = _report_path(call)
                old = f"; the last report is {made}" if made.exists() else ""
                fault = f"is not up to date ({state.why or 'it has not been made'}), and report runs no other stage"
                raise UserError(name, fault, f"`make {call.program.report}` with the same arguments does{old}")
        call.dataset.digests.save(call.dataset.write_text)
        return _bring_up_to_date(call, steps)


def _bring_up_to_date(call: Call, steps: list[Step]) -> int:
    command, dataset, say = call.command, call.dataset, call.progress.say
    for warning in call.capture.warnings:
        say(f"warning: {warning}")
    target = {"all": None, "report": call.program.report}.get(command, command)
    step = next((s for s in steps if s.stage.name == target), None)
    if step is not None and not step.decision.run:
        print(f"{target}: not needed ({step.decision.reason})")
        return 0
    wanted = _wanted(steps, target)
    found = {name: state for name, state in states(dataset, steps).items() if name in {s.stage.name for s in wanted}}
    kept = remember(call.last, call.settings, set(found), call.stages)
    if call.options.device == "cuda" and any(s.stage.device and not found[s.stage.name].ready for s in wanted):
        refuse_missing_cuda()
    for step in wanted:
        if not found[step.stage.name].ready:
            step.stage.check(call.capture)
    describe(call, steps, kept)
    _announce(call, steps, found)
    made = [s.stage.name for s in wanted if _bring(call, s)]
    describe(call, steps, kept)
    if all(state.kind == "done" for state in found.values()) and not made:
        print(f"{dataset.root}: up to date, nothing to do")
    if wanted[-1].stage.name == call.program.report:
        print(f"report: {_report_path(call)}")
    elif target is not None:
        print(f"{target}: {place_of(call, target)}")
    if stale := stale_after(dataset, steps):
        remedy = f"`make {call.program.report}` brings everything up to date"
        print(f"out of date: {', '.join(stale)} (made from earlier versions); {remedy}")
    return 0


def _announce(call: Call, steps: list[Step], found: Mapping[str, State]) -> None:
    """What will be made again and why, before it is."""
    if call.command == "all" and not all(state.ready for state in found.values()):
        for step in steps:
            if not step.decision.run:
                call.progress.say(f"{step.stage.name}: left out ({step.decision.reason})")
    for name, state in found.items():
        if state.kind in ("again", "switch") and state.root:
            verb = "made again" if state.kind == "again" else "an earlier version is put to use"
            call.progress.say(f"{name}: {verb} ({state.why})")
    if hint := keep_hint(call.last, call.settings, found, call.stages, call.command not in call.stages):
        call.progress.say(hint)


def _bring(call: Call, step: Step) -> bool:
    """Put the version of a step to use, made now where there is none; returns whether it was made. Raises UserError."""
    name, dataset = step.stage.name, call.dataset
    version = dataset.find(name, step.key)
    made = version is None
    if version is None:
        status = run_stage(call, name)
        version = dataset.find(name, step.key)
        if status:
            sys.exit(status)  # the child has said why
        if version is None:  # it made another key than was planned here
            raise UserError(name, "the capture or the program was changed during the run", "the same command goes on from here")
    dataset.use(version)
    return made


def _wanted(steps: list[Step], target: str | None) -> list[Step]:
    """The steps to bring up to date: all that run, or the target with everything upstream of it."""
    running = [s for s in steps if s.decision.run]
    if target is None:
        return running
    names, out = {target}, []
    for step in reversed(running):
        if step.stage.name in names:
            names.update(step.needs)
            out.append(step)
    return out[::-1]


def _make_alone(call: Call, steps: list[Step]) -> int:
    """The child's part of a run: one stage, whose inputs are there."""
    from pipeline.engine.execute import make_version
    from pipeline.engine.memory import allowance

    step = next(s for s in steps if s.stage.name == call.command)
    device = device_of(call.options.device) if step.stage.device else "cpu"
    allowed = allowance(step, call.capture, call.options.jobs, call.options.memory)
    make_version(call.dataset, call.capture, step, call.capture.environments, device, allowed, call.progress, steps)
    return 0


def _report_path(call: Call) -> Path:
    return place_of(call, call.program.report) / "report.html"
