"""The bus's keys: CURVE key pairs in files, and the list of those who may come in, each with a role.

A folder holds `server.key_secret`, `server.key` and `clients/NAME.key`; a client's folder holds `NAME.key_secret`,
`NAME.key` and the `server.key` of its daemon. The files are ZeroMQ certificates (RFC 4, as `zmq.auth` has them), the
keys Z85 text. Nothing here is for the loop.
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

_READABLE, _WRITABLE = 0o077, 0o022  # what group and others may do with a secret at all, and with a list
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_VALUE = re.compile(r'\s*([a-z-]+)\s*=\s*"([^"]*)"\s*')


class KeysError(Exception):
    """A key that cannot be used, made or listed; one line that names the file and what to do."""


class KeysClosedError(KeysError):
    """A key that this user may not read."""


class Role(StrEnum):
    """What a client may do: watch the topics and ask for the status, or give every command."""

    WATCH = "watch"
    OPERATE = "operate"

    def covers(self, needed: Role) -> bool:
        """Whether who has this role may do what needs `needed`."""
        return self is Role.OPERATE or needed is Role.WATCH


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A public key and its secret, Z85."""

    public: bytes
    secret: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class Credentials:
    """A client's pair, and the server that it means to speak to: another one cannot take its place."""

    pair: KeyPair
    server: bytes

    def encrypt(self, socket: zmq.Socket[bytes]) -> None:
        """Have what `socket` connects to from now on prove that it is the server, and encrypt."""
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self.pair.public)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self.pair.secret)
        socket.setsockopt(zmq.CURVE_SERVERKEY, self.server)


@dataclass(frozen=True, slots=True)
class Member:
    """One who may come in."""

    name: str
    role: Role
    public: bytes


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """The daemon's pair, and who may come in, by public key."""

    pair: KeyPair
    members: Mapping[bytes, Member]


# ---------------------------------------------------------------------------------------------------- for use


def server_keys(folder: Path) -> ServerKeys:
    """The daemon's keys out of its folder; its own pair may operate, for the recorder. Raises KeysError."""
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
    """What the daemon's own recorder comes in with: the server's pair. Raises KeysError."""
    pair = _read_pair(folder / f"{SERVER}{SECRET}")
    return Credentials(pair, pair.public)


def members(folder: Path) -> list[Member]:
    """Who may come in, by name; raises KeysError for a file that is none, and where others could add to the list."""
    clients = folder / CLIENTS
    if not clients.is_dir():
        return []
    for place in (folder, clients):
        _refuse(place, place.stat().st_mode, _WRITABLE)
    listed = [_read_member(path) for path in sorted(clients.glob(f"*{PUBLIC}"))]
    for i, member in enumerate(listed):
        for other in listed[:i]:
            if other.public == member.public:
                raise KeysError(f"{clients}: {other.name} and {member.name} have the same key; revoke one of them")
    return listed


# ------------------------------------------------------------------------------------------------- for upkeep


def make_pair(folder: Path, name: str) -> tuple[Path, Path]:
    """New files NAME.key_secret (for the owner's eyes alone) and NAME.key; raises KeysError if there are such."""
    _check_name(name)
    secret_path, public_path = (folder / f"{name}{suffix}" for suffix in (SECRET, PUBLIC))
    for path in (secret_path, public_path):
        if path.exists():
            raise KeysError(f"{path} exists already; remove it if nobody needs it any more, or take another name")
    public, secret = (key.decode("ascii") for key in zmq.curve_keypair())
    _make_folder(folder)
    _write(secret_path, 0o600, f"# Secret: stays where it is.\n{_certificate(name, public)}    secret-key = "
           f'"{secret}"\n')  # fmt: skip
    _write(public_path, 0o644, _certificate(name, public))
    return secret_path, public_path


def allow(folder: Path, path: Path, role: Role) -> Member:
    """Let the client in whose public key is in the file at `path`; named as the file is. Raises KeysError."""
    _check_name(path.stem)
    values = _read(path)
    if "secret-key" in values:
        raise KeysError(f"{path}: a secret key stays with its client; give its file {path.stem}{PUBLIC}")
    member = Member(path.stem, role, _public(path, values))
    for other in members(folder):
        if other.public == member.public:
            raise KeysError(f"{path}: this key is {other.name}'s already ({other.role}); revoke {other.name} first")
    for place in (folder, folder / CLIENTS):
        _make_folder(place)
    public = member.public.decode("ascii")
    _write(folder / CLIENTS / f"{member.name}{PUBLIC}", 0o644, _certificate(member.name, public, role))
    return member


def revoke(folder: Path, name: str) -> None:
    """Strike a client off the list; raises KeysError when it is not on it."""
    _check_name(name)
    path = folder / CLIENTS / f"{name}{PUBLIC}"
    try:
        path.unlink()
    except FileNotFoundError:
        raise KeysError(f"{path}: no such file; there are {_there(folder)}") from None
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
        raise KeysError(f"{path}: no secret key is in it; the file is named …{SECRET}")
    secret = _key(path, values["secret-key"])
    if zmq.curve_public(secret) != public:
        raise KeysError(f"{path}: its secret and public key do not belong together; make a new pair: palmd keys new")
    return KeyPair(public, secret)


def _read_member(path: Path) -> Member:
    values = _read(path, _WRITABLE)
    with suppress(ValueError):
        return Member(path.stem, Role(values.get("role", "")), _public(path, values))
    raise KeysError(f'{path}: it must have a role = "watch" or "operate"; revoke {path.stem} and allow it again')


def _read(path: Path, forbidden: int = 0) -> dict[str, str]:
    """The values in a certificate, whatever section they stand in."""
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
                raise KeysError(f"{path}: {found[1]} stands in it twice")
            values[found[1]] = found[2]
    return values


def _public(path: Path, values: Mapping[str, str]) -> bytes:
    if "public-key" not in values:
        raise KeysError(f"{path}: no public key is in it; it must be a file that palmd keys new has made")
    return _key(path, values["public-key"])


def _key(path: Path, text: str) -> bytes:
    """A key as Z85; what is wrong with it is told without showing it."""
    with suppress(ValueError, KeyError):
        key = text.encode("ascii")
        if len(key) == 40 and z85.encode(z85.decode(key)) == key:
            return key
    raise KeysError(f"{path}: a key in it is damaged; a key has 40 characters of Z85")


def _refuse(path: Path, mode: int, forbidden: int) -> None:
    """Raises KeysError when group or others may do with it what is `forbidden`."""
    if not mode & forbidden:
        return
    mode_text = f"mode {stat.S_IMODE(mode):04o}"
    if forbidden == _READABLE:
        raise KeysError(f"{path}: a secret that others than its owner can open ({mode_text}): chmod 600 {path}")
    raise KeysError(f"{path}: others than its owner can change who may come in ({mode_text}): chmod go-w {path}")


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        raise KeysError(f"{name!r} is no name: 1 to 64 letters, digits, points, hyphens and underscores")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
    except OSError as error:
        raise KeysError(f"{folder}: cannot be made ({error.strerror})") from None


def _write(path: Path, mode: int, text: str) -> None:
    """A new file with its permissions from the first moment on."""
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "w", encoding="ascii") as file:
            file.write(text)
    except FileExistsError:
        raise KeysError(f"{path} exists already: palmd keys revoke {path.stem} first") from None
    except OSError as error:
        raise KeysError(f"{path}: cannot be written ({error.strerror})") from None


def _there(folder: Path) -> str:
    return ", ".join(member.name for member in members(folder)) or "none"
