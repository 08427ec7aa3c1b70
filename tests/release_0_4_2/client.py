"""A client as a user of release 0.4.2 wrote it: by the API and the layout of the stream that its README describes.

python client.py http://127.0.0.1:PORT prints the answers. Do not change it: it shows that clients still work.
"""

import io
import json
import struct
import sys
import time
import urllib.error
import urllib.request

import numpy as np
from websockets.sync.client import connect

import tactiled

BASE = sys.argv[1]
API = BASE + "/api/v1"
HEAD = struct.Struct("<4sBBHHHHHQddffffII")  # magic ... method, 64 bytes


def request(method, path, body=None, kind="application/json"):
    data = body if isinstance(body, bytes | None) else json.dumps(body).encode()
    asked = urllib.request.Request(API + path, data, {"Content-Type": kind}, method=method)
    try:
        with urllib.request.urlopen(asked, timeout=60) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def get(path):
    status, body = request("GET", path)
    assert status == 200, (path, status, body)
    return body


def images_of_stream():
    """Shape, bytes of flags and whether there are values, by (sensor, kind), of a stream of both sensors."""
    address = API.replace("http", "ws") + "/stream?sensors=palm,skin&kinds=raw,restored&shear=skin&flow=credit"
    images, status = {}, {}
    with connect(address, max_size=None) as stream:
        stream.send('{"type": "next"}')
        while len(images) < 5 or len(status) < 2:
            message = stream.recv(timeout=60)
            if isinstance(message, str):
                fields = json.loads(message)
                if fields["type"] == "status":
                    status[fields["sensor"]] = sorted(
                        {"state", "age_s", "rate_hz", "method", "sequence"} & set(fields)
                    )
                continue
            magic, version, kind, rows, columns, flagged, named, _, *_ = HEAD.unpack_from(message)
            assert (magic, version) == (b"TCTL", 1)
            count = rows * columns * (2 if kind == 2 else 1)
            values = np.frombuffer(message, "<f4", count, 64)
            name = message[64 + 4 * count + flagged :].decode()
            assert len(name.encode()) == named
            images[f"{name} {kind}"] = [rows, columns, flagged, bool(np.isfinite(values).any())]
            stream.send('{"type": "next"}')
    return images, status


def images_of_client():
    client = tactiled.connect(BASE)
    names = [each["name"] for each in client.sensors()]
    image = next(client.stream("skin", shear=True))
    assert image.status["state"] in ("live", "stale")
    return {
        "names": names,
        "shapes": [image.raw.shape, image.restored.shape, image.flags.shape, image.shear.shape],
        "sensor": image.sensor,
        "positive": [image.sequence >= 0, image.noise_kpa > 0, image.resolution_mm > 0, image.timestamp > 1e9],
    }


def main():
    until = time.monotonic() + 60
    while any(each["state"] == "silent" for each in json.loads(get("/sensors"))["sensors"]):
        assert time.monotonic() < until, "no images"
        time.sleep(0.05)
    results = {"sensors": sorted(json.loads(get("/sensors"))["sensors"][0])}
    for path in ("/health", "/config", "/events", "/colormap", "/openapi.json", "/asyncapi.json"):
        results[path] = sorted(json.loads(get(path)))
    for resource in ("frames/raw", "frames/restored", "contacts", "kernel", "geometry", "calibration", "method"):
        results[resource] = sorted(json.loads(get(f"/sensors/palm/{resource}")))
    for kind in ("raw", "restored", "deviation"):
        results["npy " + kind] = np.load(io.BytesIO(get(f"/sensors/palm/frames/{kind}?format=npy"))).shape
    window = np.load(io.BytesIO(get("/sensors/palm/frames?kind=raw&last=2s&format=npz")))
    results["window"] = sorted(window.files)
    results["png"] = get("/sensors/palm/frames/restored?format=png&top_kpa=10")[:4].hex()
    results["shear"] = np.load(io.BytesIO(get("/sensors/skin/frames/shear?format=npy"))).shape
    results["shear of palm"] = request("GET", "/sensors/palm/frames/shear")[0]
    results["change"] = request("PUT", "/sensors/palm/method", {"method": "nnls"})[0]
    results["no method"] = request("PUT", "/sensors/palm/method", {"method": "magic"})[0]
    film = io.BytesIO()
    np.save(film, np.zeros((2, 8, 8), np.float32))
    status, restored = request(
        "POST", "/restore?sensor=palm&method=wiener", film.getvalue(), "application/octet-stream"
    )
    results["film"] = [status, np.load(io.BytesIO(restored)).shape]
    results["metrics"] = b"tactiled_" in urllib.request.urlopen(BASE + "/metrics", timeout=60).read()
    results["stream"], results["status"] = images_of_stream()
    results["client"] = images_of_client()
    print(json.dumps(results))


main()
