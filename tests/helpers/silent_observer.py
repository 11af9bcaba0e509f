"""An observer that knows nothing, for tests that need none, or as a beginning for ones that know a little."""

from palmd.daemon.systems import unknown_estimate


class SilentObserver:
    """Satisfies `palmd.observer.Observer`."""

    name, backend, object_count, late_dropped, improvements, foresees = "silent", "none", 0, 0, 0, False

    def warm_up(self):
        pass

    def feed(self, event):
        pass

    def improve(self, _t):
        return None

    def estimate(self, t):
        return unknown_estimate(t, self)

    def shape(self, _t):
        return None

    def outlook(self, _t):
        return None

    def identify(self, _t):
        return None
