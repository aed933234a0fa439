"""Requests to an ASGI application, without a network."""

import asyncio
import json
from contextlib import asynccontextmanager


@asynccontextmanager
async def running(app):
    """The application between start and stop."""
    async with app.router.lifespan_context(app):
        yield


async def request(app, method, path, body=None, token="", pieces=None, content="application/json"):
    """Status and content of the answer; `pieces` of a body come with a pause after each."""
    raw = body if isinstance(body, bytes) else b"" if body is None else json.dumps(body).encode()
    pieces = [(raw, 0.0)] if pieces is None else pieces
    messages = [
        {"type": "http.request", "body": piece, "more_body": i + 1 < len(pieces)} for i, (piece, _) in enumerate(pieces)
    ]
    pauses, sent = [pause for _, pause in pieces], []

    async def receive():
        if not messages:
            await asyncio.sleep(3600)
        message = messages.pop(0)
        await asyncio.sleep(pauses.pop(0))
        return message

    async def send(message):
        sent.append(message)

    headers = [(b"content-type", content.encode()), (b"authorization", f"Bearer {token}".encode())]
    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": method,
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "root_path": "",
        "headers": headers,
        "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 80),
    }
    await app(scope, receive, send)
    text = b"".join(message.get("body", b"") for message in sent[1:])
    status = sent[0]["status"]
    try:
        return status, json.loads(text)
    except ValueError:
        return status, text.decode()
