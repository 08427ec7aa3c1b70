"""The server's side of TLS."""

import ssl

from tactiled.config.schema import Server
from tactiled.errors import ConfigError


def context(at: Server) -> ssl.SSLContext | None:
    """The certificate and its key, ready for connections; None where none is configured.

    ConfigError where a file cannot be read or the two are no pair.
    """
    if at.tls_certificate is None or at.tls_key is None:
        return None
    for path in (at.tls_certificate, at.tls_key):
        try:
            path.open("rb").close()
        except OSError as error:
            why = f"{path}: {error.strerror}"
            raise ConfigError(f"{why}: give the PEM files of tls_certificate and tls_key") from error
    made = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        made.load_cert_chain(at.tls_certificate, at.tls_key)
    except OSError as error:  # also what OpenSSL has to say
        raise ConfigError(f"{at.tls_certificate}, {at.tls_key}: {error.strerror}: no PEM pair") from error
    return made
