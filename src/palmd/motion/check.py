"""Plans out of their files, and what `palmd check` finds wrong in configurations and plans."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from palmd.config.any_config import AnyConfig
from palmd.config.pads import PadBase
from palmd.config.plans import AnyPlanSpec
from palmd.config.two_palms import Config, PlanSpec
from palmd.console.folders import is_writable_folder, nearest
from palmd.keys import KeysClosedError, KeysError, server_keys
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import PlanError, PlanForm, Trajectory
from palmd.motion.segments import Angles
from palmd.motion.shaking import shaking_by, shaking_of
from palmd.outlinefile import OutlineError, read_library
from palmd.plausibility import implausible
from palmd.systems import LIVE, load_part
from palmd.yamlfile import ConfigError, Document, is_plan, parse, parse_config, read_document, system_meant

DEFAULT_PAD_LENGTH_MM: float = PadBase.model_fields["length_mm"].default


def _form(system: str) -> PlanForm:
    form: PlanForm = load_part(LIVE[system].plans)
    return form


def motion_limits(config: AnyConfig) -> MotionLimits:
    """The limits that a configuration sets; the arm's workspace is known only when it has said hello."""
    return _form(config.system).configured(config)


def load_trajectory(path: Path, limits: MotionLimits, start: Angles | None = None) -> Trajectory:
    """The plan in a file, within the limits; raises ConfigError with file:line:col for all that is wrong.

    start: where the palms stand (rad), as for `compile_plan`.
    """
    document = read_document(path)
    return compiled(document, plan_spec(document, limits), limits, start)


def plan_spec(document: Document, limits: MotionLimits) -> AnyPlanSpec:
    """The plan in a document, in the form that the limits' system has; raises ConfigError."""
    return parse(document, _form(limits.system).spec)


def compile_any(spec: AnyPlanSpec, limits: MotionLimits, start: Angles | None) -> Trajectory:
    """The plan as a trajectory; raises PlanError."""
    return _form(limits.system).compiled(spec, limits, start)


def compiled(document: Document, spec: AnyPlanSpec, limits: MotionLimits, start: Angles | None) -> Trajectory:
    """The compiled plan; raises ConfigError with file:line:col for what is wrong with it."""
    try:
        return compile_any(spec, limits, start)
    except PlanError as error:
        raise document.error(
            [(document.place(loc), f"{'.'.join(map(str, loc))}: {text}") for loc, text in error.problems]
        ) from None


def check_files(paths: Sequence[Path]) -> list[str]:
    """Everything wrong with these configurations and plans, as `file:line:col: what`; empty when all is well.

    A file with `segments` is a plan, checked within the limits of every configuration of its system given beside it,
    else the defaults. What a configuration names (plan, stored outlines, keys, the folder of the runs) is checked
    too, the plan within that configuration's limits alone. A plan that does not begin with a move is taken to begin
    at HOME: only the rig knows better.
    """
    errors: list[str] = []
    documents = _documents(paths, errors)
    plans = [document for document in documents if is_plan(document)]
    configs = [document for document in documents if not is_plan(document)]
    limits = [] if configs else [_limits(name, {}) for name in LIVE]
    blind: list[tuple[str, Document]] = []  # configurations, and their systems, whose observers explore by no outline
    for document in configs:
        try:
            config = parse_config(document)
        except ConfigError as error:
            errors += error.errors
            limits += _limits_of_faulty(document)
            continue
        own = motion_limits(config)
        limits.append(own)
        blind += [] if config.explores else [(config.system, document)]
        errors += implausible(document, config)
        errors += _outline_errors(document, config)
        errors += _keys_errors(document, config)
        errors += _folder_errors(document, config)
        for plan in _documents(_plan_named(document, config, errors, given=paths), errors):
            errors += _plan_errors(plan, [own])
            errors += _blind_errors(plan, [] if config.explores else [document])
    for document in plans:
        meant = [each for each in limits if _of_its_system(document, each)] or limits[:1]
        errors += _plan_errors(document, meant)
        systems = {each.system for each in meant}
        errors += _blind_errors(document, [each for name, each in blind if systems == {name}])
    return list(dict.fromkeys(errors))  # two configurations may name one plan


def shaking_notes(paths: Sequence[Path]) -> list[str]:
    """What is to be known of how good configurations and plans shake the palms, as `file: what`.

    A plan is judged on the rig of every configuration of two palms given beside it, and of the one that names it.
    """
    documents = [read_document(path) for path in paths]
    notes: list[str] = []
    configs = [(each, parse_config(each)) for each in documents if not is_plan(each)]
    plans = [each for each in documents if is_plan(each)]
    for document, config in configs:
        notes += [f"{document.path}: {note}" for note in shaking_of(config)]
        if isinstance(config, Config):
            named = [read_document(path) for path in _plan_named(document, config, [], given=paths)]
            for plan in [*plans, *named]:
                spec = plan_spec(plan, motion_limits(config))
                if isinstance(spec, PlanSpec):
                    notes += [f"{plan.path}: {note}" for note in shaking_by(spec, config)]
    return list(dict.fromkeys(notes))


def _documents(paths: Iterable[Path], errors: list[str]) -> list[Document]:
    documents = []
    for path in paths:
        try:
            documents.append(read_document(path))
        except ConfigError as error:
            errors += error.errors
    return documents


def _outline_errors(document: Document, config: AnyConfig) -> list[str]:
    """What is wrong with the stored outlines that a configuration names."""
    try:
        if config.outlines is not None:
            read_library(config.outlines)
    except OutlineError as error:
        return [document.line(document.place(("observer", "shape")), f"observer.shape: {error}")]
    return []


def _blind_errors(plan: Document, blind: Iterable[Document]) -> list[str]:
    segments = plan.data["segments"]
    last = segments[-1] if isinstance(segments, list) and segments else None
    if not (isinstance(last, dict) and "explore" in last):
        return []
    text = f"observer.primary: {plan.path} explores, which needs an outline to go by: set it to shape"
    return [config.line(config.place(("observer", "primary")), text) for config in blind]


def _keys_errors(document: Document, config: AnyConfig) -> list[str]:
    """What is wrong with the folder of keys that a configuration names, unless it is closed to this user."""
    if config.bus.keys is None:
        return []
    try:
        server_keys(config.bus.keys)
    except KeysClosedError:  # the service's own: `palmd doctor` tells what its user may do
        return []
    except KeysError as error:
        return [document.line(document.place(("bus", "keys")), f"bus.keys: {error}")]
    return []


def _folder_errors(document: Document, config: AnyConfig) -> list[str]:
    """Whether runs can be put where a configuration says; its folder is made when it is needed."""
    place = document.place(("record", "directory"))
    try:
        there = nearest(config.record.directory)
    except PermissionError:  # the service's own, most often: `palmd doctor` tells what its user may do
        return []
    except OSError as error:
        return [document.line(place, f"record.directory: {config.record.directory}: {error.strerror}")]
    if not there.is_dir():
        return [document.line(place, f"record.directory: {there} is no folder: nothing could be recorded")]
    if not is_writable_folder(there) and there.stat().st_uid in (
        os.geteuid(),
        0,
    ):  # another user's is the service's own
        text = f"record.directory: {there} is not writable: nothing could be recorded; see its permissions"
        return [document.line(place, text)]
    return []


def _plan_named(document: Document, config: AnyConfig, errors: list[str], *, given: Sequence[Path]) -> list[Path]:
    """The plan that a configuration names, unless it is one of those given; one that is not there is an error."""
    if config.plan is None:
        return []
    try:
        there = config.plan.exists()
    except OSError:  # whoever reads it tells why
        return [config.plan]
    if not there:
        beside = {each.stem: each for each in _plans_beside(config.plan)}
        near = difflib.get_close_matches(config.plan.stem, beside, n=1)
        meant = f"; is {beside[near[0]]} meant?" if near else ""
        errors.append(document.line(document.place(("plan",)), f"plan: {config.plan} does not exist{meant}"))
        return []
    resolved = config.plan.resolve()
    return [] if any(path.resolve() == resolved for path in given) else [config.plan]


def _plans_beside(plan: Path) -> list[Path]:
    try:
        return sorted(each for each in plan.parent.iterdir() if each.suffix in (".yaml", ".yml"))
    except OSError:
        return []


def _limits(system: str, section: Any) -> MotionLimits:
    """What a section of limits sets over usual pads; raises ValidationError."""
    form = _form(system)
    return form.over(form.section.model_validate(section), DEFAULT_PAD_LENGTH_MM)


def _limits_of_faulty(document: Document) -> list[MotionLimits]:
    """The limits of a configuration that is wrong elsewhere, so that its plans are checked all the same."""
    section = document.data.get("limits", {}) if isinstance(document.data, dict) else None
    try:
        return [_limits(system_meant(document), section)]
    except (ConfigError, ValidationError):
        return []


def _of_its_system(plan: Document, limits: MotionLimits) -> bool:
    """Whether a plan has the form that these limits' system gives plans."""
    try:
        plan_spec(plan, limits)
    except ConfigError:
        return False
    return True


def _plan_errors(document: Document, limits: Sequence[MotionLimits]) -> list[str]:
    errors: dict[str, None] = {}
    for each in limits:
        try:
            compiled(document, plan_spec(document, each), each, None)
        except ConfigError as error:
            errors |= dict.fromkeys(error.errors)
    return list(errors)
