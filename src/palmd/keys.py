"""The bus's keys: CURVE key pairs in files, and the list of clients that may connect, each with a role.

A folder holds `server.key_secret`, `server.key` and `clients/NAME.key`; a client's folder holds `NAME.key_secret`,
`NAME.key` and the `server.key` of its daemon. The files are ZeroMQ certificates (RFC 4, as in `zmq.auth`), the keys Z85
text. Nothing here is for the loop.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import zmq
from zmq.utils import z85

PUBLIC, SECRET = ".key", ".key_secret"
SERVER, CLIENTS = "server", "clients"
FILE_BYTES_MAX = 4096

_READABLE, _WRITABLE = 0o077, 0o022  # mode bits that must not be set for a secret, and for a list of clients
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_VALUE = re.compile(r'\s*([a-z-]+)\s*=\s*"([^"]*)"\s*')


class KeysError(Exception):
    """A key that cannot be used, made or listed; one line that names the file and the remedy."""


class KeysClosedError(KeysError):
    """A key that this user may not read."""


class Role(StrEnum):
    """What a client may do: read the topics and the status, or give every command."""

    WATCH = "watch"
    OPERATE = "operate"

    def covers(self, needed: Role) -> bool:
        """Whether this role includes the role `needed`."""
        return self is Role.OPERATE or needed is Role.WATCH


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A public key and its secret, in Z85."""

    public: bytes
    secret: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class Credentials:
    """A client's key pair, and the public key of its server, which no other server can impersonate."""

    pair: KeyPair
    server: bytes

    def encrypt(self, socket: zmq.Socket[bytes]) -> None:
        """Encrypt connections that `socket` makes from now on, and authenticate the server."""
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self.pair.public)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self.pair.secret)
        socket.setsockopt(zmq.CURVE_SERVERKEY, self.server)


@dataclass(frozen=True, slots=True)
class Member:
    """A client that may connect."""

    name: str
    role: Role
    public: bytes


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """The daemon's pair, and the clients that may connect, by public key."""

    pair: KeyPair
    members: Mapping[bytes, Member]


# ---------------------------------------------------------------------------------------------------- for use


def server_keys(folder: Path) -> ServerKeys:
    """The daemon's keys from its folder; its own pair may operate, for the recorder. Raises KeysError."""
    pair = _read_pair(folder / f"{SERVER}{SECRET}")
    own = Member(SERVER, Role.OPERATE, pair.public)
    return ServerKeys(pair, {member.public: member for member in (*members(folder), own)})


def client_credentials(path: Path) -> Credentials:
    """A client's secret key file, with the daemon's `server.key` beside it; raises KeysError."""
    pair, server = _read_pair(path), path.parent / f"{SERVER}{PUBLIC}"
    if not server.exists():
        raise KeysError(f"{server}: no such file; copy the daemon's {SERVER}{PUBLIC} there")
    return Credentials(pair, _public(server, _read(server)))


def own_credentials(folder: Path) -> Credentials:
    """Credentials of the daemon's own recorder: the server's pair. Raises KeysError."""
    pair = _read_pair(folder / f"{SERVER}{SECRET}")
    return Credentials(pair, pair.public)


def members(folder: Path) -> list[Member]:
    """The listed clients, by name; raises KeysError for an invalid file, and if other users could add to the list."""
    clients = folder / CLIENTS
    if not clients.is_dir():
        return []
    for folder_path in (folder, clients):
        _refuse(folder_path, folder_path.stat().st_mode, _WRITABLE)
    listed = [_read_member(path) for path in sorted(clients.glob(f"*{PUBLIC}"))]
    for i, member in enumerate(listed):
        for other in listed[:i]:
            if other.public == member.public:
                raise KeysError(f"{clients}: {other.name} and {member.name} have the same key; revoke one of them")
    return listed


# ------------------------------------------------------------------------------------------------- for upkeep


def make_pair(folder: Path, name: str) -> tuple[Path, Path]:
    """Create NAME.key_secret (readable by its owner only) and NAME.key; raises KeysError if they exist."""
    _check_name(name)
    secret_path, public_path = (folder / f"{name}{suffix}" for suffix in (SECRET, PUBLIC))
    for path in (secret_path, public_path):
        if path.exists():
            raise KeysError(f"{path} exists already; remove it if it is not needed, or use another name")
    public, secret = (key.decode("ascii") for key in zmq.curve_keypair())
    _make_folder(folder)
    _write(secret_path, 0o600, f"# Secret: never copy this file.\n{_certificate(name, public)}    secret-key = "
           f'"{secret}"\n')  # fmt: skip
    _write(public_path, 0o644, _certificate(name, public))
    return secret_path, public_path


def allow(folder: Path, path: Path, role: Role) -> Member:
    """Let the client connect whose public key is in the file at `path`, under the file's name. Raises KeysError."""
    _check_name(path.stem)
    values = _read(path)
    if "secret-key" in values:
        raise KeysError(
            f"{path}: this is the client's secret key, which must not be copied; pass its file {path.stem}{PUBLIC}"
        )
    member = Member(path.stem, role, _public(path, values))
    for other in members(folder):
        if other.public == member.public:
            raise KeysError(
                f"{path}: this key is already listed as {other.name} ({other.role}); revoke {other.name} first"
            )
    for place in (folder, folder / CLIENTS):
        _make_folder(place)
    public = member.public.decode("ascii")
    _write(folder / CLIENTS / f"{member.name}{PUBLIC}", 0o644, _certificate(member.name, public, role))
    return member


def revoke(folder: Path, name: str) -> None:
    """Remove a client from the list; raises KeysError if it is not listed."""
    _check_name(name)
    path = folder / CLIENTS / f"{name}{PUBLIC}"
    try:
        path.unlink()
    except FileNotFoundError:
        raise KeysError(f"{path}: no such file; listed clients: {_client_names(folder)}") from None
    except OSError as error:
        raise KeysError(f"{path}: cannot be removed ({error.strerror})") from None


# -------------------------------------------------------------------------------------------------- the files


def _certificate(name: str, public: str, role: Role | None = None) -> str:
    metadata = f'metadata\n    name = "{name}"\n' + ("" if role is None else f'    role = "{role}"\n')
    return f'{metadata}curve\n    public-key = "{public}"\n'


def _read_pair(path: Path) -> KeyPair:
    values = _read(path, _READABLE)
    public = _public(path, values)
    if "secret-key" not in values:
        raise KeysError(f"{path}: it contains no secret key; that file is named …{SECRET}")
    secret = _key(path, values["secret-key"])
    if zmq.curve_public(secret) != public:
        raise KeysError(f"{path}: its secret and public key do not match; make a new pair: palmd keys new")
    return KeyPair(public, secret)


def _read_member(path: Path) -> Member:
    values = _read(path, _WRITABLE)
    with suppress(ValueError):
        return Member(path.stem, Role(values.get("role", "")), _public(path, values))
    raise KeysError(f'{path}: it must have a role = "watch" or "operate"; revoke {path.stem} and allow it again')


def _read(path: Path, forbidden: int = 0) -> dict[str, str]:
    """The values in a certificate, in any section."""
    try:
        with path.open("rb") as file:
            if forbidden:
                _refuse(path, os.fstat(file.fileno()).st_mode, forbidden)
            content = file.read(FILE_BYTES_MAX + 1)
    except FileNotFoundError:
        raise KeysError(f"{path}: no such file; palmd keys new makes one") from None
    except PermissionError as error:
        raise KeysClosedError(f"{path}: cannot be read ({error.strerror})") from None
    except OSError as error:
        raise KeysError(f"{path}: cannot be read ({error.strerror})") from None
    values: dict[str, str] = {}
    for line in content.decode("utf-8", errors="replace").splitlines() if len(content) <= FILE_BYTES_MAX else ():
        found = _VALUE.fullmatch(line)
        if found is not None:
            if found[1] in values:
                raise KeysError(f"{path}: {found[1]} occurs twice")
            values[found[1]] = found[2]
    return values


def _public(path: Path, values: Mapping[str, str]) -> bytes:
    if "public-key" not in values:
        raise KeysError(f"{path}: it contains no public key; it must be a file made by palmd keys new")
    return _key(path, values["public-key"])


def _key(path: Path, text: str) -> bytes:
    """A key as Z85; errors do not show it."""
    with suppress(ValueError, KeyError):
        key = text.encode("ascii")
        if len(key) == 40 and z85.encode(z85.decode(key)) == key:
            return key
    raise KeysError(f"{path}: it contains an invalid key; a key has 40 characters of Z85")


def _refuse(path: Path, mode: int, forbidden: int) -> None:
    """Raises KeysError if group or others have one of the `forbidden` permissions."""
    if not mode & forbidden:
        return
    mode_text = f"mode {stat.S_IMODE(mode):04o}"
    if forbidden == _READABLE:
        raise KeysError(f"{path}: other users can read this secret ({mode_text}): chmod 600 {path}")
    raise KeysError(f"{path}: other users can change which clients may connect ({mode_text}): chmod go-w {path}")


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        raise KeysError(f"{name!r} is not a valid name: 1 to 64 letters, digits, points, hyphens and underscores")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    except OSError as error:
        raise KeysError(f"{folder}: cannot be created ({error.strerror})") from None


def _write(path: Path, mode: int, text: str) -> None:
    """Create a file with its permissions set from the start."""
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "w", encoding="ascii") as file:
            file.write(text)
    except FileExistsError:
        raise KeysError(f"{path} exists already: palmd keys revoke {path.stem} first") from None
    except OSError as error:
        raise KeysError(f"{path}: cannot be written ({error.strerror})") from None


def _client_names(folder: Path) -> str:
    return ", ".join(member.name for member in members(folder)) or "none"
