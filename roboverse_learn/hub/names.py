"""Names on the Hugging Face hub, and what it says when it does not do what it is asked."""

import contextlib
import re
from collections.abc import Iterator

from envs.core.errors import ConfigError

_NAME = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*")


def check_name(key: str, name: str) -> None:
    """Checks that a key's value is the name of a repository, ``owner/name``.

    Raises:
        ConfigError: It is not.
    """
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id

    given = f"given '{name}'" if name else "nothing is given"
    if not _NAME.fullmatch(name):
        raise ConfigError(f"{key}= is a name on the Hugging Face hub, as owner/name; {given}.")
    try:
        validate_repo_id(name)
    except HFValidationError as error:
        raise ConfigError(f"{key}= is a name that the Hugging Face hub refuses; {given}. {error}") from error


@contextlib.contextmanager
def hub_errors(what: str) -> Iterator[None]:
    """Turns what the hub or the network says into one sentence.

    Args:
        what: What the block does, for the message, such as ``publish to 'owner/name'``.

    Raises:
        ConfigError: The hub refused, or was not reached.
    """
    from httpx import HTTPError
    from huggingface_hub.errors import (
        HfHubHTTPError,
        LocalEntryNotFoundError,
        LocalTokenNotFoundError,
        OfflineModeIsEnabled,
    )

    refusals = (HfHubHTTPError, HTTPError, LocalTokenNotFoundError, LocalEntryNotFoundError)
    try:
        yield
    except (*refusals, OfflineModeIsEnabled) as error:
        response = getattr(error, "response", None)
        status = getattr(response, "status_code", None)
        if isinstance(error, LocalTokenNotFoundError) or status in (401, 403):
            advice = "Log in with a token that may do this: hf auth login."
        elif status == 404:
            advice = "Look whether the name is right, and whether it is private: hf auth login."
        else:
            advice = "It needs a network, and HF_HUB_OFFLINE must not be set."
        reason = " ".join(str(error).split())[:200].rstrip(".")
        raise ConfigError(f"Could not {what}: {reason}. {advice}") from error
