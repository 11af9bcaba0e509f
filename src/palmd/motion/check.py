"""Load plans from files, and check configurations and plans (`palmd check`)."""

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
from palmd.yamlfile import ConfigError, Document, configured_system, is_plan, parse, parse_config, read_document

DEFAULT_PAD_LENGTH_MM: float = PadBase.model_fields["length_mm"].default


def _form(system: str) -> PlanForm:
    form: PlanForm = load_part(LIVE[system].plans)
    return form


def motion_limits(config: AnyConfig) -> MotionLimits:
    """Return the limits that a configuration sets; the arm's workspace is known only after its handshake."""
    return _form(config.system).configured(config)


def load_trajectory(path: Path, limits: MotionLimits) -> Trajectory:
    """Load a plan and compile it within the limits; raises ConfigError with file:line:col of every error."""
    document = read_document(path)
    return compiled(document, plan_spec(document, limits), limits, None)


def plan_spec(document: Document, limits: MotionLimits) -> AnyPlanSpec:
    """Parse the plan in a document in the form of the limits' system; raises ConfigError."""
    return parse(document, _form(limits.system).spec)


def compile_any(spec: AnyPlanSpec, limits: MotionLimits, start: Angles | None) -> Trajectory:
    """Compile the plan into a trajectory; raises PlanError."""
    return _form(limits.system).compiled(spec, limits, start)


def compiled(document: Document, spec: AnyPlanSpec, limits: MotionLimits, start: Angles | None) -> Trajectory:
    """Compile the plan; raises ConfigError with file:line:col of every error."""
    try:
        return compile_any(spec, limits, start)
    except PlanError as error:
        raise document.error(
            [(document.place(loc), f"{'.'.join(map(str, loc))}: {text}") for loc, text in error.problems]
        ) from None


def check_files(paths: Sequence[Path]) -> list[str]:
    """Return all errors of these configurations and plans, as `file:line:col: text`; empty if there are none.

    A file with `segments` is a plan. It is checked against the limits of every given configuration of its system, or
    the default limits. What a configuration refers to (plan, stored outlines, keys, folder of the runs) is checked
    too, the plan against that configuration's limits only. A plan that does not begin with a move is assumed to begin
    at HOME, since the pose of the rig is unknown here.
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
        applicable = [each for each in limits if _of_its_system(document, each)] or limits[:1]
        errors += _plan_errors(document, applicable)
        systems = {each.system for each in applicable}
        errors += _blind_errors(document, [each for name, each in blind if systems == {name}])
    return list(dict.fromkeys(errors))  # two configurations may name one plan


def shaking_notes(paths: Sequence[Path]) -> list[str]:
    """Return notes on the vibration and dither of valid configurations and plans, as `file: text`.

    A plan is judged on the rig of every given configuration of two palms, and of those that refer to it.
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


def _error(document: Document, place: tuple[str, ...], text: str) -> str:
    return document.line(document.place(place), f"{'.'.join(place)}: {text}")


def _outline_errors(document: Document, config: AnyConfig) -> list[str]:
    """Return the error of the stored outlines that a configuration refers to, if any."""
    try:
        if config.outlines is not None:
            read_library(config.outlines)
    except OutlineError as error:
        return [_error(document, ("observer", "shape"), str(error))]
    return []


def _blind_errors(plan: Document, blind: Iterable[Document]) -> list[str]:
    segments = plan.data["segments"]
    last = segments[-1] if isinstance(segments, list) and segments else None
    if not (isinstance(last, dict) and "explore" in last):
        return []
    text = f"{plan.path} explores, which needs an observer that estimates an outline: set it to shape"
    return [_error(config, ("observer", "primary"), text) for config in blind]


def _keys_errors(document: Document, config: AnyConfig) -> list[str]:
    """Return the error of the configured folder of keys, if any and if this user may read it."""
    if config.bus.keys is None:
        return []
    try:
        server_keys(config.bus.keys)
    except KeysClosedError:  # the service's own: `palmd doctor` reports what its user may do
        return []
    except KeysError as error:
        return [_error(document, ("bus", "keys"), str(error))]
    return []


def _folder_errors(document: Document, config: AnyConfig) -> list[str]:
    """Return the error of the configured folder of runs, if any; a missing folder is created when needed."""
    place = "record", "directory"
    try:
        there = nearest(config.record.directory)
    except PermissionError:  # the service's own, most often: `palmd doctor` reports what its user may do
        return []
    except OSError as error:
        return [_error(document, place, f"{config.record.directory}: {error.strerror}")]
    if not there.is_dir():
        return [_error(document, place, f"{there} is no folder: nothing could be recorded")]
    # another user's is the service's own
    if not is_writable_folder(there) and there.stat().st_uid in (os.geteuid(), 0):
        return [_error(document, place, f"{there} is not writable: nothing could be recorded; see its permissions")]
    return []


def _plan_named(document: Document, config: AnyConfig, errors: list[str], *, given: Sequence[Path]) -> list[Path]:
    """Return the plan that a configuration refers to, unless it is among those given; a missing file is an error."""
    if config.plan is None:
        return []
    try:
        there = config.plan.exists()
    except OSError:  # reported when it is read
        return [config.plan]
    if not there:
        beside = {each.stem: each for each in _plans_beside(config.plan)}
        near = difflib.get_close_matches(config.plan.stem, beside, n=1)
        hint = f"; did you mean {beside[near[0]]}?" if near else ""
        errors.append(_error(document, ("plan",), f"{config.plan} does not exist{hint}"))
        return []
    resolved = config.plan.resolve()
    return [] if any(path.resolve() == resolved for path in given) else [config.plan]


def _plans_beside(plan: Path) -> list[Path]:
    try:
        return sorted(each for each in plan.parent.iterdir() if each.suffix in (".yaml", ".yml"))
    except OSError:
        return []


def _limits(system: str, section: Any) -> MotionLimits:
    """Return the limits of a configuration section, for pads of the default length; raises ValidationError."""
    form = _form(system)
    return form.over(form.section.model_validate(section), DEFAULT_PAD_LENGTH_MM)


def _limits_of_faulty(document: Document) -> list[MotionLimits]:
    """Return the limits of a configuration with errors elsewhere, so that plans can still be checked."""
    section = document.data.get("limits", {}) if isinstance(document.data, dict) else None
    try:
        return [_limits(configured_system(document), section)]
    except (ConfigError, ValidationError):
        return []


def _of_its_system(plan: Document, limits: MotionLimits) -> bool:
    """True if a plan parses in the form of these limits' system."""
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
