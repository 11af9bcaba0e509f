"""Prints the estimate once a second: python subscriber.py [ADDRESS]. Needs pyzmq and msgpack."""

import math
import sys

import msgpack
import zmq

socket = zmq.Context().socket(zmq.SUB)
socket.connect(sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:9872")
socket.subscribe("palm/estimate")
while True:
    _topic, payload, _sent = socket.recv_multipart()
    estimate = msgpack.unpackb(payload)
    if estimate["seq"] % 100:  # 100 messages a second
        continue
    if not estimate["valid"]:
        print("no valid estimate yet", flush=True)
        continue
    r1, r2, psi = ((estimate[name], estimate["sd"][name]) for name in ("r1_m", "r2_m", "psi_rad"))
    print(
        f"r1 {r1[0] * 1e3:.2f} ± {r1[1] * 1e3:.2f} mm, r2 {r2[0] * 1e3:.2f} ± {r2[1] * 1e3:.2f} mm,",
        f"psi {math.degrees(psi[0]):.1f} ± {math.degrees(psi[1]):.1f}°, touched {estimate['touched']:.0%}",
        flush=True,
    )
