"""Key files: which are made, trusted and refused, with their messages."""

import os
import stat

import pytest
import zmq
import zmq.auth

from palmd import keys
from palmd.cli import main
from palmd.keys import KeysError, Role


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """A daemon's folder `keys` and a client's folder `mine`, made as the manual describes."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PALMD_KEY", raising=False)
    for arguments in (
        ["new", "server"],
        ["new", "client", "desk", "-d", "mine"],
        ["allow", "mine/desk.key", "--role", "watch"],
    ):
        assert main(["keys", *arguments]) == 0
    (tmp_path / "mine/server.key").write_bytes((tmp_path / "keys/server.key").read_bytes())
    return tmp_path


def fails(capsys, *arguments):
    """The one-line error of a command that fails."""
    capsys.readouterr()
    assert main(list(arguments)) == 1
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    return line


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("umask", [0o000, 0o002, 0o077])
def test_secrets_are_readable_by_their_owner_alone_whatever_the_umask(tmp_path, umask):
    before = os.umask(umask)
    try:
        secret, public = keys.make_pair(tmp_path / "keys", "server")
        keys.make_pair(tmp_path, "desk")
        keys.allow(tmp_path / "keys", tmp_path / "desk.key", Role.WATCH)
    finally:
        os.umask(before)
    assert mode(secret) == 0o600
    assert mode(public) & 0o133 == 0
    assert [member.name for member in keys.members(tmp_path / "keys")] == ["desk"]
    assert mode(tmp_path / "keys" / keys.CLIENTS / "desk.key") & 0o133 == 0


def test_a_client_on_the_list_has_its_role_and_the_daemon_itself_may_operate(folders):
    guarded, client = keys.server_keys(folders / "keys"), keys.client_credentials(folders / "mine/desk.key_secret")
    roles = {member.name: member.role for member in guarded.members.values()}
    assert roles == {"desk": Role.WATCH, "server": Role.OPERATE}
    assert guarded.members[client.pair.public].name == "desk"
    assert client.server == guarded.pair.public == keys.own_credentials(folders / "keys").server


def test_zeromqs_own_tools_and_palmd_read_each_others_files(folders):
    public, secret = zmq.auth.load_certificate(folders / "mine/desk.key_secret")
    assert keys.client_credentials(folders / "mine/desk.key_secret").pair == keys.KeyPair(public, secret)
    assert zmq.auth.load_certificate(folders / "keys/clients/desk.key") == (public, None)
    theirs, _ = zmq.auth.create_certificates(folders, "theirs")
    member = keys.allow(folders / "keys", folders / "theirs.key", Role.OPERATE)
    assert member.public == zmq.auth.load_certificate(theirs)[0]


def test_secrets_do_not_appear_in_a_traceback(folders):
    guarded = keys.server_keys(folders / "keys")
    assert guarded.pair.secret.decode() not in repr(guarded)


def test_list_and_revoke(folders, capsys):
    capsys.readouterr()
    assert main(["keys", "list"]) == 0
    assert capsys.readouterr().out.split()[:2] == ["desk", "watch"]
    assert main(["keys", "revoke", "desk"]) == 0
    assert "restart of palmd" in capsys.readouterr().out
    assert main(["keys", "list"]) == 0
    assert "no client is allowed" in capsys.readouterr().out
    assert fails(capsys, "keys", "revoke", "desk") == "keys/clients/desk.key: no such file; listed clients: none"


@pytest.mark.parametrize("bits", [0o640, 0o604, 0o610, 0o602, 0o666])
@pytest.mark.parametrize("which", ["mine/desk.key_secret", "keys/server.key_secret"])
def test_a_secret_readable_by_others_is_not_used(folders, bits, which):
    (folders / which).chmod(bits)
    use = keys.client_credentials if which.startswith("mine") else lambda path: keys.server_keys(path.parent)
    with pytest.raises(KeysError, match=rf"other users can .* chmod 600 {folders / which}$"):
        use(folders / which)


@pytest.mark.parametrize("which", ["keys", "keys/clients", "keys/clients/desk.key"])
@pytest.mark.parametrize("bits", [0o020, 0o002])
def test_a_list_writable_by_others_is_not_used(folders, which, bits):
    (folders / which).chmod(mode(folders / which) | bits)
    with pytest.raises(KeysError, match=rf"chmod go-w {folders / which}$"):
        keys.server_keys(folders / "keys")


def test_keys_that_cannot_be_allowed(folders, capsys):
    assert main(["keys", "new", "client", "ann", "-d", "mine"]) == 0
    allow = ("keys", "allow", "--role", "operate")
    assert "pass its file ann.key" in fails(capsys, *allow, "mine/ann.key_secret")
    assert "listed as desk (watch); revoke desk first" in fails(capsys, *allow, "mine/desk.key")
    assert "mine/nobody.key: no such file" in fails(capsys, *allow, "mine/nobody.key")
    (folders / "mine/ann.key").rename(folders / "desk.key")
    assert "exists already: palmd keys revoke desk first" in fails(capsys, *allow, "desk.key")


@pytest.mark.parametrize("name", ["", "../ann", ".ann", "a/b", "ann\n", "a" * 65, "né"])
def test_invalid_names_are_refused(folders, capsys, name):
    assert "is not a valid name" in fails(capsys, "keys", "new", "client", name)
    assert "is not a valid name" in fails(capsys, "keys", "revoke", name)


def test_nothing_is_overwritten(folders, capsys):
    before = (folders / "keys/server.key_secret").read_bytes()
    assert "exists already" in fails(capsys, "keys", "new", "server")
    assert "exists already" in fails(capsys, "keys", "new", "client", "desk", "-d", "mine")
    (folders / "mine/desk.key_secret").unlink()
    assert "desk.key exists already" in fails(capsys, "keys", "new", "client", "desk", "-d", "mine")
    assert not (folders / "mine/desk.key_secret").exists()
    assert "cannot be called server" in fails(capsys, "keys", "new", "client", "server", "-d", "other")
    assert (folders / "keys/server.key_secret").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("secret-key", "other-key"), "contains no secret key"),
        (lambda text: text.replace("public-key", "other-key"), "contains no public key"),
        (lambda text: text[:-10] + '"\n', "damaged"),
        (lambda text: text.rstrip()[:-1] + '00000"\n', "damaged"),  # valid Z85 of another length
        (lambda text: text + '    secret-key = "x"\n', "secret-key occurs twice"),
        (lambda _: "", "contains no public key"),
        (lambda _: "\0\xff" * 5000, "contains no public key"),
    ],
)
def test_a_damaged_key_is_reported_without_being_shown(folders, change, said):
    path = folders / "mine/desk.key_secret"
    secret = keys.client_credentials(path).pair.secret.decode()
    path.write_text(change(path.read_text()), encoding="latin-1")
    with pytest.raises(KeysError, match=said) as caught:
        keys.client_credentials(path)
    assert secret[:20] not in str(caught.value)


def test_keys_that_do_not_belong_together_are_refused(folders):
    path, other = folders / "mine/desk.key_secret", zmq.curve_keypair()[1].decode()
    secret = keys.client_credentials(path).pair.secret.decode()
    path.write_text(path.read_text().replace(secret, other))
    with pytest.raises(KeysError, match="do not match"):
        keys.client_credentials(path)


@pytest.mark.parametrize("role", ['"admin"', '"WATCH"', '""', "watch"])
def test_a_listed_key_without_a_role_is_refused(folders, role):
    path = folders / "keys/clients/desk.key"
    path.write_text(path.read_text().replace('"watch"', role))
    with pytest.raises(KeysError, match=r"desk\.key: it must have a role"):
        keys.server_keys(folders / "keys")


def test_two_names_for_one_key_are_refused(folders):
    clients = folders / "keys/clients"
    (clients / "evil.key").write_text((clients / "desk.key").read_text().replace("watch", "operate"))
    with pytest.raises(KeysError, match="desk and evil have the same key"):
        keys.server_keys(folders / "keys")


def test_a_client_needs_the_daemons_public_key(folders, capsys):
    (folders / "mine/server.key").unlink()
    for command in (["ctl", "status"], ["top", "--once"], ["view", "--no-browser"], ["ctl", "explore"]):
        assert fails(capsys, *command, "--key", "mine/desk.key_secret") == (
            "mine/server.key: no such file; copy the daemon's server.key there"
        )


def test_the_key_may_be_in_the_environment(folders, capsys, monkeypatch):
    monkeypatch.setenv("PALMD_KEY", "mine/nobody.key_secret")
    assert fails(capsys, "ctl", "status").startswith("mine/nobody.key_secret: no such file")


@pytest.mark.parametrize(("more", "counts"), [(0, True), (1, False)])
def test_a_file_that_is_too_long_is_refused_without_quoting_it(tmp_path, more, counts):
    path = tmp_path / "long"
    said = 'role = "watch"\n'
    path.write_text(said + "#" * (keys.FILE_BYTES_MAX - len(said) + more), encoding="ascii")
    assert (keys._read(path) == {"role": "watch"}) is counts
