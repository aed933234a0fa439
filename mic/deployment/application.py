"""HTTP interface of a service: paths, JSON of requests and answers, OpenAPI document, access by a token.

Every request but that of the health needs the token. Bodies are bounded in size and in time, numbers must be finite,
and each error is one sentence.
"""

from __future__ import annotations

import asyncio
import hmac
import json
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Annotated, Any, Literal, Self
from uuid import uuid4

import numpy as np
from fastapi import Depends, FastAPI, HTTPException, Path, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, PlainTextResponse, Response
from fastapi.routing import APIRoute
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, StringConstraints, model_validator

from mic import __version__
from mic.deployment.service import Busy, Conflict, Service
from mic.errors import ArgumentError, SceneError, StorageError
from mic.scene.deviation import deviation_unit

__all__ = ["BODY_SECONDS", "LARGEST", "application"]

LARGEST = 1_000_000  #: bytes of the largest body
BODY_SECONDS = 10.0  #: s in which the body of a request must arrive
SHARES = (0.5, 0.95, 0.99)  # quantiles of the metrics

_BEARER = HTTPBearer(auto_error=False)
Number = Annotated[FiniteFloat, Field(strict=True)]
Identifier = Annotated[str, StringConstraints(pattern=r"^[\w.:/#+-]{1,100}$")]


class Assembly(BaseModel):
    """One assembly."""

    model_config = ConfigDict(extra="forbid")

    id: Identifier | None = Field(None, description="Serial number. A repeated request gets the same answer.")
    deviations: dict[str, Number] = Field(
        {}, description="Measured deviations by name, N or mm (`GET /model` lists them); the others are unknown."
    )
    scan: Identifier | None = Field(None, description="Serial number of scans in the folder `--scans`.")

    @model_validator(mode="after")
    def _measured(self) -> Self:
        if not self.deviations and self.scan is None:
            raise ValueError("give deviations, or a scan")
        return self


class Characteristic(BaseModel):
    """A key characteristic, mm from nominal, with its 95 % interval and its limits."""

    name: str
    value: float
    low: float
    high: float
    lower: float | None
    upper: float | None
    adjusted: float | None = Field(None, description="Value with the proposed adjustments.")
    verdict: Literal["accepted", "open", "rejected"]


class ProposedChange(BaseModel):
    """A change of a locator or clamp."""

    name: str
    change: float
    unit: Literal["mm", "N"]


class Certificate(BaseModel):
    """Method by which the characteristics were computed, and its accuracy."""

    method: Literal["learnt", "evaluated", "none"]
    residual: float | None = Field(None, description="Largest scale-free residual of the contact problems.")
    tolerance: float | None = Field(None, description="Residual up to which a contact problem counts as solved.")
    adjusted_residual: float | None = Field(None, description="As `residual`, with the proposed adjustments.")
    error_bound: dict[str, float] | None = Field(None, description="Bound of 95 % of the emulator's errors, mm.")


class Answer(BaseModel):
    """The answer for one assembly."""

    id: str
    verdict: Literal["accepted", "open", "rejected", "refused", "failed"]
    reason: str = Field(description="Reason of a refusal or a failure; else the proposed adjustment, if any.")
    adjustments: list[ProposedChange] = Field(description="Proposed together; empty if none is needed or helps.")
    characteristics: list[Characteristic]
    certificate: Certificate
    distance: float | None = Field(description="Largest distance of a deviation from its mean, standard deviations.")
    messages: list[str] = Field([], description="What the scans say of each part.")
    drift: list[str] = Field(description="Deviations of the latest assemblies that left the scene's distributions.")
    model: str = Field(description="Fingerprint of the model.")
    version: str = Field(description="Version of the program.")
    seconds: float = Field(description="Time in queue and evaluation, s.")


class Problem(BaseModel):
    """Why a request has no answer."""

    detail: str


_ERRORS: dict[int | str, dict[str, Any]] = {
    status: {"model": Problem, "description": description}
    for status, description in {
        400: "The body is no JSON.",
        401: "The token is missing or wrong.",
        408: "The body did not arrive in time.",
        409: "The identifier belongs to an assembly with other content.",
        413: "The body is too large.",
        415: "The body is not sent as JSON.",
        422: "A name is unknown, a value is no finite number, or a key is wrong.",
        503: "The queue is full; repeat the request.",
        504: "Not answered in time; ask for the answer later.",
        507: "The request cannot be logged; it was not accepted.",
    }.items()
}


def application(service: Service, token: str, seconds: float) -> FastAPI:
    """The web application of a service.

    Parameters
    ----------
    service : Service
    token : str
    seconds : float
        Time in which an answer is waited for, s.
    """

    @asynccontextmanager
    async def running(_: FastAPI) -> AsyncIterator[None]:
        service.start()
        yield
        await service.stop()

    def authorised(given: Annotated[HTTPAuthorizationCredentials | None, Depends(_BEARER)]) -> None:
        if given is None or not hmac.compare_digest(given.credentials.encode(), token.encode()):
            headers = {"WWW-Authenticate": "Bearer"}
            raise HTTPException(401, "the token is missing or wrong: send it as 'Authorization: Bearer …'", headers)

    app = FastAPI(title="mic serve", version=__version__, lifespan=running, docs_url=None, redoc_url=None)
    app.add_middleware(_BoundedBodies)
    app.router.route_class = _StrictRoute
    protected: dict[str, Any] = {"dependencies": [Depends(authorised)]}

    @app.post("/assemblies", response_model=Answer, responses=_ERRORS, **protected)
    async def predict(assembly: Assembly) -> dict[str, Any]:
        """Predict one assembly: verdict, characteristics, adjustment and certificate."""
        return await _asked(service, assembly, seconds)

    @app.get("/assemblies/{name:path}", response_model=Answer, responses={202: {"model": Problem}}, **protected)
    async def answer(name: Annotated[str, Path(description="Identifier of the assembly.")]) -> Any:
        """The answer for an assembly that was requested before."""
        logged = service.log.known.get(name)
        if logged is None:
            raise HTTPException(404, "there is no such assembly among the latest; the log has all")
        if logged.answer is None:
            return JSONResponse({"detail": "the assembly waits for its evaluation"}, 202)
        return _answer(service, name, logged.answer)

    @app.get("/model", **protected)
    async def model() -> dict[str, Any]:
        """Deviations and key characteristics of the model; its fingerprint, version and settings."""
        return _model(service)

    @app.get("/health", responses={503: {"model": Problem}})
    async def health() -> Any:
        """Whether assemblies can be answered; needs no token."""
        state = {"status": service.problem or "ok", "workers": service.workers, "waiting": service.waiting}
        return JSONResponse(state, 503 if service.problem else 200)

    @app.get("/metrics", response_class=PlainTextResponse, **protected)
    async def metrics() -> str:
        """Counts, times and drift, in the text format of Prometheus."""
        return _metrics(service)

    app.add_exception_handler(RequestValidationError, _invalid)

    @app.middleware("http")
    async def count(request: Request, handler: Any) -> Any:
        response = await handler(request)
        if response.status_code >= 400:
            service.counts[f"status {response.status_code}"] += 1
        return response

    return app


async def _asked(service: Service, assembly: Assembly, seconds: float) -> dict[str, Any]:
    """The answer for an assembly, or the error of HTTP that tells why there is none."""
    name = assembly.id or uuid4().hex
    try:
        content = await service.content(assembly.deviations, assembly.scan)
        asked = asyncio.ensure_future(service.ask(name, content))
        answer = await asyncio.wait_for(asyncio.shield(asked), seconds)
    except Busy:
        raise HTTPException(503, "the queue is full; repeat the request", {"Retry-After": "1"}) from None
    except Conflict:
        raise HTTPException(409, f"id {name} belongs to an assembly with other content; give another") from None
    except (ArgumentError, SceneError) as problem:
        raise HTTPException(422, str(problem)) from None
    except StorageError as problem:
        raise HTTPException(507, str(problem)) from None
    except TimeoutError:
        late = f"not answered within {seconds:g} s; GET /assemblies/{name} gives the answer later"
        raise HTTPException(504, late) from None
    return _answer(service, name, answer)


async def _invalid(request: Request, problem: Any) -> JSONResponse:
    # The default handler repeats the input, which may be no JSON, or long.
    first = problem.errors()[0]
    if first["loc"] == ("body",) and "json" not in request.headers.get("Content-Type", ""):
        return JSONResponse({"detail": "the body: send JSON, with 'Content-Type: application/json'"}, 415)
    if first["type"] == "json_invalid":
        return JSONResponse({"detail": f"the body is no JSON: {first['ctx']['error']}, byte {first['loc'][-1]}"}, 400)
    place = ".".join(map(str, first["loc"][1:]))[:200].encode("ascii", "replace").decode() or "body"
    return JSONResponse({"detail": f"{place}: {first['msg']}"}, 422)


def _answer(service: Service, name: str, answer: dict[str, Any]) -> dict[str, Any]:
    described = {key: service.description[key] for key in ("model", "version")}
    return {"id": name, **answer, "drift": service.drift, **described}


def _model(service: Service) -> dict[str, Any]:
    scene = service.model.scene
    return {
        **service.description,
        "scene": scene.name,
        "deviations": [
            {"name": item.name, "unit": deviation_unit(item, scene), "mean": item.mean, "sigma": item.sigma}
            for item in scene.deviations
        ],
        "characteristics": [
            {"name": item.name, **{key: value if np.isfinite(value) else None for key, value in limits.items()}}
            for item in scene.measurements
            for limits in [{"lower": item.lower, "upper": item.upper}]
        ],
    }


def _metrics(service: Service) -> str:
    verdicts = {key: count for key, count in service.counts.items() if not key.startswith("status")}
    refused = {key.split()[1]: count for key, count in service.counts.items() if key.startswith("status")}
    lines = ["# TYPE mic_answers_total counter"]
    lines += [f'mic_answers_total{{verdict="{key}"}} {count}' for key, count in sorted(verdicts.items())]
    lines += ["# TYPE mic_refused_requests_total counter"]
    lines += [f'mic_refused_requests_total{{status="{key}"}} {count}' for key, count in sorted(refused.items())]
    lines += ["# TYPE mic_answer_seconds summary"]
    if service.times:
        for share, value in zip(SHARES, np.quantile(list(service.times), SHARES)):
            lines.append(f'mic_answer_seconds{{quantile="{share}"}} {value:.6f}')
    for name, value in (
        ("waiting", service.waiting),
        ("queue_limit", service.limit),
        ("workers", service.workers),
        ("drifted_deviations", len(service.drift)),
        ("damaged_log_lines", service.log.damaged),
        ("healthy", int(not service.problem)),
    ):
        lines += [f"# TYPE mic_{name} gauge", f"mic_{name} {value}"]
    return "\n".join(lines) + "\n"


class _StrictRequest(Request):
    """A request in whose JSON no key occurs twice: the standard library silently keeps the last value."""

    async def json(self) -> Any:
        return json.loads(await self.body(), object_pairs_hook=_unique)


class _StrictRoute(APIRoute):
    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handler = super().get_route_handler()

        async def strict(request: Request) -> Response:
            return await handler(_StrictRequest(request.scope, request.receive))

        return strict


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice = next(key for i, (key, _) in enumerate(pairs) if key in dict(pairs[:i]))
        raise HTTPException(400, f"the body: {twice[:50]!a} occurs twice; leave one out")
    return found


class _BoundedBodies:
    """ASGI middleware that refuses large bodies (status 413), and bodies that do not arrive in time (408)."""

    def __init__(self, app: Any):
        self._app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        body, more = b"", True
        try:
            async with asyncio.timeout(BODY_SECONDS):
                while more:
                    message = await receive()
                    if message["type"] == "http.disconnect":
                        return
                    body, more = body + message.get("body", b""), message.get("more_body", False)
                    if len(body) > LARGEST:
                        await _refuse(413, f"the body is larger than {LARGEST} bytes", scope, receive, send)
                        return
        except TimeoutError:
            await _refuse(408, f"the body did not arrive within {BODY_SECONDS:g} s", scope, receive, send)
            return
        given = iter([{"type": "http.request", "body": body, "more_body": False}])

        async def receive_body() -> Any:
            return next(given, None) or await receive()

        await self._app(scope, receive_body, send)


async def _refuse(status: int, reason: str, scope: Any, receive: Any, send: Any) -> None:
    await JSONResponse({"detail": reason}, status, {"Connection": "close"})(scope, receive, send)
