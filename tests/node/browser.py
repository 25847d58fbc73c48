"""A headless Chromium of the system, driven by its DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any

import aiohttp

_PATIENCE = 20.0  # s


def find_chromium() -> str | None:
    """Path of the browser; None where there is none."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Browser:
    """One browser with one tab; use as an asynchronous context manager."""

    async def __aenter__(self) -> Browser:
        self._folder = Path(tempfile.mkdtemp(prefix="nmt-browser-"))
        program = find_chromium()
        assert program
        self._process = await asyncio.create_subprocess_exec(
            program, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars",
            "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
            f"--user-data-dir={self._folder}", "--remote-debugging-port=0", "about:blank",
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.DEVNULL,
        )  # fmt: skip
        port_file = self._folder / "DevToolsActivePort"
        await self._wait(lambda: port_file.exists() and port_file.read_text().count("\n") >= 1)
        port, path = port_file.read_text().splitlines()[:2]
        self._session = aiohttp.ClientSession()
        self._socket = await self._session.ws_connect(f"http://127.0.0.1:{port}{path}", max_msg_size=2**26)
        self._answers: dict[int, asyncio.Future[Any]] = {}
        self._number = 0
        self.errors: list[str] = []
        """What the page's scripts complained about."""
        self._reading = asyncio.create_task(self._read())
        target = await self._call("Target.createTarget", url="about:blank")
        attached = await self._call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._tab = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            await self.call(f"{domain}.enable")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reading.cancel()
        await asyncio.gather(self._reading, return_exceptions=True)
        await self._socket.close()
        await self._session.close()
        self._process.kill()
        await self._process.wait()
        await asyncio.sleep(0.1)
        shutil.rmtree(self._folder, ignore_errors=True)

    async def _wait(self, condition: Any) -> None:
        loop = asyncio.get_running_loop()
        end = loop.time() + _PATIENCE
        while not condition():
            assert loop.time() < end, "the browser does not answer"
            await asyncio.sleep(0.05)

    async def _read(self) -> None:
        async for message in self._socket:
            answer = json.loads(message.data)
            if "id" in answer:
                future = self._answers.pop(answer["id"])
                if not future.done():
                    future.set_result(answer)
            elif answer["method"] == "Runtime.exceptionThrown":
                self.errors.append(str(answer["params"]["exceptionDetails"].get("exception", {}).get("description")))
            elif answer["method"] == "Log.entryAdded" and answer["params"]["entry"]["level"] == "error":
                self.errors.append(f"{answer['params']['entry']['text']} {answer['params']['entry'].get('url', '')}")

    async def _call(self, method: str, session: str | None = None, **params: Any) -> Any:
        self._number += 1
        number = self._number
        self._answers[number] = asyncio.get_running_loop().create_future()
        message = {"id": number, "method": method, "params": params}
        await self._socket.send_json(message if session is None else {**message, "sessionId": session})
        answer = await asyncio.wait_for(self._answers[number], _PATIENCE)
        assert "error" not in answer, (method, answer)
        return answer["result"]

    async def call(self, method: str, **params: Any) -> Any:
        """A method of the protocol, for the tab."""
        return await self._call(method, self._tab, **params)

    async def open(self, address: str) -> None:
        """Go to an address."""
        await self.call("Page.navigate", url=address)

    async def value(self, expression: str) -> Any:
        """Value of an expression in the page."""
        answer = await self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def text(self, element: str) -> str:
        """Text of an element of this id; empty if there is none."""
        return str(await self.value(f"(document.getElementById('{element}') || {{}}).textContent || ''"))

    async def until(self, expression: str, patience: float = _PATIENCE) -> None:
        """Wait until an expression is true in the page."""
        loop = asyncio.get_running_loop()
        end = loop.time() + patience
        guarded = f"(() => {{ try {{ return Boolean({expression}) }} catch {{ return false }} }})()"
        while not await self.value(guarded):
            if loop.time() > end:
                raise AssertionError((expression, self.errors, await self.value("document.body.innerText")))
            await asyncio.sleep(0.05)

    async def click(self, element: str) -> None:
        """Click the element of this id."""
        await self.value(f"document.getElementById('{element}').click()")

    async def submit(self, form: str) -> None:
        """Submit the form of this id as its button does."""
        await self.value(f"document.getElementById('{form}').requestSubmit()")

    async def key(self, key: str) -> None:
        """Press a key."""
        for kind in ("keyDown", "keyUp"):
            await self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    async def size(self, width: int, height: int, dark: bool = False) -> None:
        """Size of the window in pixels, and its colours."""
        await self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 700
        )
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        await self.call("Emulation.setEmulatedMedia", features=scheme)

    async def picture(self, path: Path, whole: bool = False) -> None:
        """Screenshot as PNG."""
        answer = await self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(answer["data"]))
