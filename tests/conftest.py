"""For all tests: linear algebra has one thread, and Ctrl-C means what it means at a terminal."""

import signal

from palmd.blas import one_thread_from_here

one_thread_from_here()  # as in every command: the threads of two workers would spin against each other

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts what runs in its background deaf to SIGINT, and that is handed on to every process that a test
    # starts and interrupts. What a handler catches, other programs begin with as usual.
    signal.signal(signal.SIGINT, signal.default_int_handler)
