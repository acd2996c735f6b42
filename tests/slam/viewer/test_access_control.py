"""Who is let in: by the head of the request alone."""

import pytest

from slam.viewer.access_control import AccessControl, is_local

TOKEN = "a-token-of-the-operator"


@pytest.mark.parametrize("host", ["127.0.0.1:8321", "localhost:8321", "LOCALHOST", "[::1]:80"])
def test_this_machine_is_let_in_under_its_local_names(host):
    assert AccessControl().refusal("/feed", [host], []) == ""
    assert AccessControl().refusal("/feed", [host], [f"http://{host}"]) == ""


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "https://127.0.0.1:8321", "http://127.0.0.1:9", "null", ""]
)
def test_a_page_of_another_site_is_not(origin):
    assert "other sites" in AccessControl().refusal("/feed", ["127.0.0.1:8321"], [origin])


@pytest.mark.parametrize("host", ["evil.example:8321", "127.0.0.1.evil.example", "0.0.0.0:8321"])
def test_a_name_that_was_made_to_point_here_is_not(host):
    assert "not served under the name" in AccessControl().refusal("/", [host], [f"http://{host}"])


@pytest.mark.parametrize("hosts", [[], ["a", "b"], ["a b"], ["x;y"], [""], ["localhost:123456"]])
def test_a_malformed_host_is_not(hosts):
    assert "Host" in AccessControl(TOKEN).refusal(f"/?token={TOKEN}", hosts, [])


def test_with_a_token_any_name_will_do_but_not_without_it():
    guard, host = AccessControl(TOKEN), ["robot.lan:8321"]
    assert guard.refusal(f"/feed?token={TOKEN}", host, ["http://robot.lan:8321"]) == ""
    for target in ("/feed", "/feed?token=", f"/feed?token={TOKEN}x", "/feed?token=\u00e4", "/"):
        assert "token" in guard.refusal(target, host, [])
    assert "other sites" in guard.refusal(f"/feed?token={TOKEN}", host, ["http://evil.example"])
    assert guard.refusal("/view.js", host, [], public=True) == ""


def test_which_addresses_are_of_this_machine_alone():
    assert all(map(is_local, ("127.0.0.1", "::1", "localhost", "127.1.2.3")))
    assert not any(map(is_local, ("0.0.0.0", "::", "192.168.0.7", "robot.lan", "")))
