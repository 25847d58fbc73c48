"""What the user told pip about package indexes and the network, handed on to uv, which reads none of pip's settings.

The values go from environment to environment and never onto a command line: an address may hold a password, and
command lines are written to the log.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess

from .places import VENV_PYTHON

SECTIONS = ("global", "install", ":env:")  # of pip's settings; the later ones win
FALSE = ("", "0", "false", "no", "off")


def pip_settings(environment: dict[str, str]) -> dict[str, str]:
    """pip's settings for an installation, from its files and variables; empty if pip does not say."""
    command = [VENV_PYTHON, "-m", "pip", "config", "list"]
    answer = subprocess.run(command, capture_output=True, text=True, env=environment)
    return parse_settings(answer.stdout)


def parse_settings(listing: str) -> dict[str, str]:
    """Settings out of what ``pip config list`` prints: ``section.name='value'`` on each line."""
    found: dict[str, dict[str, str]] = {section: {} for section in SECTIONS}
    for section, name, value in re.findall(r"^(\S+?)\.([\w-]+)=(['\"].*['\"])$", listing, re.M):
        if section in found:
            found[section][name] = str(ast.literal_eval(value))
    return {name: value for section in SECTIONS for name, value in found[section].items()}


def uv_variables(settings: dict[str, str], environment: dict[str, str]) -> dict[str, str]:
    """Variables that say the same to uv; one that the environment has already is left alone."""
    local = [place for place in settings.get("find-links", "").split() if "://" in place or os.path.exists(place)]
    timeout = settings.get("timeout", settings.get("default-timeout", ""))
    values = {
        "UV_DEFAULT_INDEX": settings.get("index-url", ""),
        "UV_INDEX": " ".join(settings.get("extra-index-url", "").split()),
        "UV_FIND_LINKS": ",".join(local),
        "UV_NO_INDEX": "" if settings.get("no-index", "").lower() in FALSE else "1",
        "UV_INSECURE_HOST": " ".join(settings.get("trusted-host", "").split()),
        "UV_HTTP_TIMEOUT": timeout.partition(".")[0],
        "SSL_CERT_FILE": settings.get("cert", ""),
        "HTTPS_PROXY": settings.get("proxy", ""),
        "HTTP_PROXY": settings.get("proxy", ""),
    }
    taken = {name.upper() for name, value in environment.items() if value}
    return {name: value for name, value in values.items() if value and name not in taken}
