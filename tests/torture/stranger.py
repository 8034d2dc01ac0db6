"""What a stranger hears who has no token: in a namespace where nothing else listens, it asks every socket that does.

Prints a line of JSON: of each socket its process, its address, and what it answered. Ray's servers speak gRPC, but for
one that speaks HTTP. Which calls one knows is its own matter: each is asked for one of every service.
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
"""One of the GCS, and one of each of a raylet's two servers."""


def frame(kind: int, flags: int, stream: int, payload: bytes = b"") -> bytes:
    """Write a frame of HTTP/2. RFC 9113, section 4.1."""
    return struct.pack(">I", len(payload))[1:] + struct.pack(">BBI", kind, flags, stream) + payload


def literal(name: str, value: str) -> bytes:
    """Write a header that is in no table. RFC 7541, section 6.2.2."""
    return b"\0" + bytes([len(name)]) + name.encode() + bytes([len(value)]) + value.encode()


def heard(address: tuple[str, int], words: bytes, until: str) -> str:
    """Say something to a server, and listen until it has said what a pattern finds; give its group."""
    said = b""
    with socket.create_connection(address, 10) as connection:
        connection.settimeout(10)
        connection.sendall(words)
        while (found := re.search(until.encode(), said)) is None:
            got = connection.recv(65536)
            assert got, f"{address}: expected {until}, came {said!r}"
            said += got
    return found[1].decode()


def status_of_call(address: tuple[str, int], call: str) -> int:
    """Call a method of gRPC with an empty message; give its status: 12 is "no such method", 16 "who are you?"."""
    headers = {":method": "POST", ":scheme": "http", ":path": call, ":authority": address[0]}
    headers |= {"te": "trailers", "content-type": "application/grpc"}
    block = b"".join(literal(name, value) for name, value in headers.items())
    words = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + frame(4, 0, 0)  # our settings: none
    words += frame(1, 4, 1, block) + frame(0, 1, 1, b"\0" * 5)  # the headers; the message, which is the end
    return int(heard(address, words, r"grpc-status.(\d+)"))


def status_of_page(address: tuple[str, int]) -> int:
    """Ask for a page by HTTP; give its status."""
    return int(heard(address, b"GET / HTTP/1.0\r\n\r\n", r"^HTTP/1\.\d (\d+)"))


def main() -> None:
    """Ask them all."""
    told = []
    for found in psutil.net_connections("inet"):
        if found.status == psutil.CONN_LISTEN:
            name = psutil.Process(found.pid).name()
            address = ("127.0.0.1" if found.laddr.ip == "::" else found.laddr.ip, found.laddr.port)
            speaks_grpc = name in ("gcs_server", "raylet")
            answers = [status_of_call(address, call) for call in CALLS] if speaks_grpc else [status_of_page(address)]
            told.append({"process": name, "address": found.laddr, "answers": answers})
    print(json.dumps(told))


if __name__ == "__main__":
    main()
