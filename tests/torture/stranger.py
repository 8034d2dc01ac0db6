"""A client without a token: it calls every listening socket, in a namespace where only the cluster listens.

Prints one line of JSON: the process, address and answers of each socket. Ray's servers speak gRPC, except one that
speaks HTTP. Every gRPC server receives one call of each service, whether or not it knows the service.
"""

import json
import re
import socket
import struct

import psutil

CALLS = (
    "/ray.rpc.NodeInfoGcsService/GetAllNodeInfo",
    "/ray.rpc.NodeManagerService/GetResourceLoad",
    "/ray.rpc.ObjectManagerService/Pull",
)
"""One call of the GCS, and one of each of a raylet's two servers."""


def frame(kind: int, flags: int, stream: int, payload: bytes = b"") -> bytes:
    """Encode an HTTP/2 frame. RFC 9113, section 4.1."""
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


def literal(name: str, value: str) -> bytes:
    """Encode a header without indexing. RFC 7541, section 6.2.2."""
    return b"\0" + bytes([len(name)]) + name.encode() + bytes([len(value)]) + value.encode()


def heard(address: tuple[str, int], words: bytes, until: str) -> str:
    """Send bytes to a server and read until a pattern matches; return the match's group."""
    said = b""
    with socket.create_connection(address, 10) as connection:
        connection.settimeout(10)
        connection.sendall(words)
        while (found := re.search(until.encode(), said)) is None:
            got = connection.recv(65536)
            assert got, f"{address}: expected {until}, got {said!r}"
            said += got
    return found[1].decode()


def status_of_call(address: tuple[str, int], call: str) -> int:
    """Call a gRPC method with an empty message; return its status: 12 is UNIMPLEMENTED, 16 UNAUTHENTICATED."""
    headers = {":method": "POST", ":scheme": "http", ":path": call, ":authority": address[0]}
    headers |= {"te": "trailers", "content-type": "application/grpc"}
    block = b"".join(literal(name, value) for name, value in headers.items())
    words = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(4, 0, 0)  # empty SETTINGS
    words += frame(1, 4, 1, block) + frame(0, 1, 1, b"\0" * 5)  # HEADERS, then DATA with END_STREAM
    return int(heard(address, words, r"grpc-status.(\d+)"))


def status_of_page(address: tuple[str, int]) -> int:
    """Request a page by HTTP; return its status."""
    return int(heard(address, b"GET / HTTP/1.0\r\n\r\n", r"^HTTP/1\.\d (\d+)"))


def main() -> None:
    """Call every listening socket, and print the answers."""
    answered = []
    for found in psutil.net_connections("inet"):
        if found.status == psutil.CONN_LISTEN:
            name = psutil.Process(found.pid).name()
            address = ("127.0.0.1" if found.laddr.ip == "::" else found.laddr.ip, found.laddr.port)
            speaks_grpc = name in ("gcs_server", "raylet")
            answers = [status_of_call(address, call) for call in CALLS] if speaks_grpc else [status_of_page(address)]
            answered.append({"process": name, "address": found.laddr, "answers": answers})
    print(json.dumps(answered))


if __name__ == "__main__":
    main()
