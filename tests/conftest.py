"""For all tests: Ctrl-C means what it means at a terminal, wherever the tests were started."""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts what runs in its background deaf to SIGINT, and that is handed on to every process that a test
    # starts and interrupts. What a handler catches, other programs begin with as usual.
    signal.signal(signal.SIGINT, signal.default_int_handler)
