"""Motion plans that several tests run."""

from palmd.config.two_palms import PlanSpec

SWING = PlanSpec.model_validate(
    {
        "name": "swing",
        "repeat": "forever",
        "segments": [
            {"move": {"phi1_deg": 45, "phi2_deg": 90}, "duration_s": 0.3},
            {"sine": {"phi1_deg": 12, "phi2_deg": 4}, "frequency_hz": 0.5, "duration_s": 20},
        ],
    }
)
SHORT = PlanSpec.model_validate(
    {"name": "short", "segments": [{"rate": {"phi1_deg_s": 20}, "until": {"phi1_deg": 55}}]}
)
