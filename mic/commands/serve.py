"""``mic serve``: predictions over HTTP; ``mic export``: the model as an FMI unit."""

from __future__ import annotations

from functools import partial

from mic.commands.invocation import first_rank_only, open_model
from mic.commands.output import CommandConsole
from mic.commands.predict import scan_predictor, scene_with_meshes, train_predictor
from mic.errors import MissingLibrary, SceneError, Stopped
from mic.execution.engine import choose
from mic.system.files import append_text
from mic.system.port import check_port

__all__ = ["export", "serve"]


@first_rank_only
def serve(source, port, host, token, log, queue, seconds, engine, scans, **prediction):
    """``mic serve``, with the values of its options (:mod:`mic.options`)."""
    try:
        from mic.deployment.server import read_token  # FastAPI is an optional dependency
        from mic.deployment.server import serve as run_server
    except ModuleNotFoundError as missing:
        if not (missing.name or "").startswith(("fastapi", "starlette", "uvicorn")):
            raise
        needs = "mic serve needs the libraries fastapi and uvicorn; install them: pip install 'mic-contact[serve]'"
        raise MissingLibrary(needs) from None
    from mic.deployment.assembly_log import AssemblyLog
    from mic.deployment.service import ScanFolder, Service

    if scans is not None and not scans.is_dir():
        raise SceneError(f"--scans {scans}: there is no such folder; create it, or give another")
    port, secret, workers = check_port(port, host), read_token(token), choose(engine or "local")
    AssemblyLog(log, {})  # raises before the training, as does the next line
    append_text(log, "")
    law, folder = prediction.pop("law"), None
    settings = {key: list(value) if isinstance(value, tuple) else value for key, value in prediction.items()}
    try:
        if scans is not None:
            console = CommandConsole()
            reader, predictor = scan_predictor(console, scene_with_meshes(source), law, prediction)
            folder = ScanFolder(reader, scans)
        else:
            console, model, _, law, _ = open_model(source, law)
            predictor = train_predictor(console, model, law, **prediction)
    except ValueError as problem:
        raise SceneError(f"serve: {problem}") from None
    service = Service(predictor, partial(AssemblyLog, log), workers, settings, queue, seconds, scans=folder)
    if service.log.damaged:
        console.warn("warning", f"{log}: {service.log.damaged} lines are cut short or altered; they are ignored")
    if service.log.pending:
        console.say(f"{len(service.log.pending)} assemblies of an earlier service are evaluated first.")
    console.say(f"Serving http://{host}:{port} with {service.workers} workers; token: {token}; log: {log}.")
    console.say("The service describes itself at /openapi.json. Press Ctrl-C to stop.")
    try:
        run_server(service, secret, host, port, seconds)
    except (KeyboardInterrupt, Stopped):
        pass
    console.say(f"Stopped: {service.answered} assemblies were answered.")


@first_rank_only
def export(source, fmu, shim, force, law):
    """``mic export``, with the values of its options (:mod:`mic.options`)."""
    from mic.deployment.fmi_unit import check_unit, write_unit

    check_unit(fmu)
    console, model, _, law, _ = open_model(source, law)
    try:
        count = write_unit(model, fmu, law, shim, force)
    except ValueError as problem:
        raise SceneError(f"export: {problem}") from None
    console.say(f"{fmu}: {count} inputs, {len(model.scene.measurements)} outputs.")
