"""What a page over https needs: a certificate, the user's own or a self-signed one, and this machine's names.

Browsers give a phone's orientation and a headset's controllers to pages over https alone, this machine's own
``localhost`` excepted.
"""

import contextlib
import hashlib
import ipaddress
import logging
import os
import shutil
import socket
import ssl
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from envs.core.assets import cache_dir
from envs.core.errors import ConfigError
from envs.core.fingerprint import digest

DAYS = 365
"""Days for which a self-signed certificate holds; it is made again on its last."""

OWN_FILES = "Give a certificate and its key, as PEM files: cert=<file> key=<file>."

log = logging.getLogger(__name__)


def tls(cert: str, key: str) -> ssl.SSLContext:
    """Returns the context of a certificate.

    Raises:
        ConfigError: A file is missing, or is none.
    """
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(cert, key)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"cert={cert} key={key}: {error}. {OWN_FILES}") from error
    return context


def tls_of(host: str, cert: str, key: str, *, https: bool) -> ssl.SSLContext | None:
    """Returns the context of the user's certificate, or of a self-signed one, or None for http.

    Args:
        host: Where the server listens.
        cert: File of the user's certificate; empty where there is none.
        key: File of its key.
        https: Whether a page over https is wanted without one.

    Raises:
        ConfigError: A file is missing or is none, or no certificate can be made.
    """
    if cert or not https:
        return tls(cert, key) if cert else None
    names = dict.fromkeys((*addresses(host), "localhost", socket.gethostname()))
    file = self_signed(list(names), cache_dir("teleoperation"))
    log.info(
        "The certificate is self-signed, so a browser warns before it opens the page. SHA-256: %s",
        fingerprint(file),
    )
    return tls(str(file), str(file))


def self_signed(names: Sequence[str], folder: Path) -> Path:
    """Returns a PEM file with a key and its self-signed certificate, which is made where none holds.

    The same names give the same file, so a browser that has accepted it warns once. Only this user can read
    it.

    Args:
        names: Host names and addresses of the server.
        folder: Where the file is kept.

    Raises:
        ConfigError: There is no ``openssl``, it fails, or the folder cannot be written.
    """
    openssl = shutil.which("openssl")
    if openssl is None:
        raise ConfigError(
            "https=true makes a certificate with the program openssl, and there is none. "
            f"Install it, or do without: {OWN_FILES}"
        )
    file = folder / f"{digest(list(names))}.pem"
    try:
        if file.is_file() and _holds(openssl, file):
            file.chmod(0o600)
            return file
        with tempfile.TemporaryDirectory(dir=folder) as made:  # which only this user can enter
            whole = Path(made) / "whole.pem"
            _make(openssl, names, Path(made))
            with os.fdopen(os.open(whole, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as out:
                out.write((Path(made) / "key.pem").read_bytes() + (Path(made) / "cert.pem").read_bytes())
            whole.replace(file)
    except OSError as error:
        raise ConfigError(f"https=true keeps its certificate as {file}: {error}. {OWN_FILES}") from error
    return file


def _holds(openssl: str, file: Path) -> bool:
    """Returns whether a file's certificate is one, and holds for another day."""
    words = [openssl, "x509", "-in", str(file), "-noout", "-checkend", "86400"]
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def _make(openssl: str, names: Sequence[str], folder: Path) -> None:
    """Makes ``key.pem`` and ``cert.pem`` in a folder."""
    subject = ",".join(f"{'IP' if _is_address(name) else 'DNS'}:{name}" for name in names)
    words = ["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-sha256"]
    words += [
        "-days",
        str(DAYS),
        "-subj",
        "/CN=RoboVerse teleoperation",
        "-addext",
        f"subjectAltName={subject}",
    ]
    words += ["-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem")]
    result = subprocess.run([openssl, *words], capture_output=True, text=True, errors="replace", check=False)
    if result.returncode:
        said = (result.stderr.strip().splitlines() or ["nothing was said"])[-1]
        raise ConfigError(
            f"https=true: openssl makes no certificate for {', '.join(names)}: {said}. {OWN_FILES}"
        )


def _is_address(name: str) -> bool:
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(name)
        return True
    return False


def fingerprint(file: Path) -> str:
    """Returns the SHA-256 fingerprint of a file's certificate, as browsers show it."""
    text = file.read_text(encoding="ascii")
    der = ssl.PEM_cert_to_DER_cert(text[text.index(ssl.PEM_HEADER) :])
    return hashlib.sha256(der).digest().hex(":").upper()


def addresses(host: str) -> list[str]:
    """Returns the addresses under which browsers may find a server, this machine's own first."""
    if host not in ("0.0.0.0", "::"):
        return [host]
    found: list[str] = []
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(
            ("192.0.2.1", 9)
        )  # sends nothing: the system chooses the address that faces the network
        found.append(str(probe.getsockname()[0]))
    with contextlib.suppress(OSError):
        entries = socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
        found += [str(entry[4][0]) for entry in entries]
    return list(dict.fromkeys(["127.0.0.1", *(each for each in found if not each.startswith("127."))]))
