"""The server's side of TLS."""

import ssl

from tactiled.config.schema import Server
from tactiled.errors import TactileError


def context(at: Server) -> ssl.SSLContext | None:
    """The certificate and its key, ready for connections; None where none is configured.

    TactileError where a file is missing or the two are no pair.
    """
    if at.tls_certificate is None or at.tls_key is None:
        return None
    for path in (at.tls_certificate, at.tls_key):
        if not path.is_file():
            raise TactileError(f"{path}: no such file: give the PEM files of tls_certificate and tls_key")
    made = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        made.load_cert_chain(at.tls_certificate, at.tls_key)
    except OSError as error:  # also what OpenSSL has to say
        raise TactileError(f"{at.tls_certificate}, {at.tls_key}: {error.strerror}: no PEM pair") from error
    return made
