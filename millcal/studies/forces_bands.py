"""Where the study's errors lie: 99.8 % bands of a study of ten repeats, bootstrapped from forty, at three levels of noise.

They were published with the corrected equations of the method, from another program with another draw of the noise, and are widened
for the noise of the bands themselves: by 15 %, those of ratios by 7 %. They hold for the study's own structure.
"""

from millcal.studies.forces_methods import (
    GTLS,
    GTLS_MODAL,
    GTLS_MORE,
    GTLS_WINDOWED,
    LS,
    LS_ALL,
    RLS,
    RTLS,
    RTLS_WINDOWED,
    TLS_ALL,
)

Level = tuple[float, float]  # N, m/s^2
Band = tuple[float, float]

SOFT, LOUD, HAMMER = (0.0, 0.4), (0.0, 1.0), (25.0, 0.0)

FRF_ERRORS: dict[
    Level, tuple[Band, Band, Band]
] = {  # per cent: plain and windowed within a tenth, modal, of which ten repeats are ten draws, within a fifth
    SOFT: ((5.4, 6.6), (1.98, 2.42), (0.48, 0.72)),
    LOUD: ((13.4, 16.4), (4.95, 6.05), (1.20, 1.80)),
    HAMMER: ((2.79, 3.41), (0.36, 0.44), (0.83, 1.25)),
}

BANDS: dict[Level, dict[str, tuple[Band, Band]]] = {  # per cent, Ktc and Krc
    SOFT: {
        LS: ((5.3, 11), (8.7, 18)),
        RLS: ((5.4, 10), (7.8, 16)),
        RTLS: ((5.4, 11), (8, 16)),
        LS_ALL: ((4.2, 8.3), (7.3, 15)),
        TLS_ALL: ((4.2, 8.4), (7.4, 16)),
        GTLS: ((2.5, 5), (3.8, 7.5)),
        GTLS_MORE: ((2.3, 4.7), (3.4, 7.2)),
        RTLS_WINDOWED: ((2, 3.9), (3, 6.1)),
        GTLS_WINDOWED: ((1.2, 2.3), (1.7, 3.9)),
        GTLS_MODAL: ((0.6, 1.6), (1.2, 3)),
    },
    LOUD: {
        LS: ((13, 27), (21, 44)),
        RLS: ((13, 26), (19, 40)),
        RTLS: ((14, 28), (21, 44)),
        LS_ALL: ((10, 21), (18, 38)),
        TLS_ALL: ((10, 22), (19, 41)),
        GTLS: ((6.2, 13), (9.9, 20)),
        GTLS_MORE: ((5.7, 12), (8.7, 19)),
        RTLS_WINDOWED: ((5, 9.9), (7.5, 15)),
        GTLS_WINDOWED: ((2.9, 5.7), (4.2, 9.6)),
        GTLS_MODAL: ((1.5, 4.3), (2.8, 7.5)),
    },
    HAMMER: {
        LS: ((2.8, 5.6), (4, 8.7)),
        RLS: ((3.3, 6.5), (3.8, 8.8)),
        RTLS: ((3.3, 6.5), (3.8, 8.8)),
        LS_ALL: ((3.9, 7.8), (4.2, 9.9)),
        TLS_ALL: ((3.9, 7.8), (4.2, 9.9)),
        GTLS: ((1.9, 3.6), (2.7, 5.1)),
        GTLS_MORE: ((1.8, 3.4), (2.6, 5.1)),
        RTLS_WINDOWED: ((0.21, 0.7), (0.55, 1.3)),
        GTLS_WINDOWED: ((0.32, 0.54), (0.43, 0.77)),
        GTLS_MODAL: ((0.6, 1.4), (0.7, 1.7)),
    },
}

RATIOS: dict[Level, dict[tuple[str, str], tuple[Band, Band]]] = {  # of one error to another's, Ktc and Krc
    SOFT: {
        (RTLS, LS): ((0.78, 1.25), (0.75, 1.09)),
        (LS_ALL, LS): ((0.57, 1.06), (0.67, 1.06)),
        (GTLS, LS): ((0.32, 0.70), (0.34, 0.60)),
        (GTLS, RTLS): ((0.33, 0.67), (0.37, 0.66)),
        (GTLS_WINDOWED, RTLS): ((0.16, 0.30), (0.17, 0.32)),
        (GTLS_MODAL, RTLS): ((0.09, 0.18), (0.12, 0.23)),
        (GTLS_WINDOWED, RTLS_WINDOWED): ((0.42, 0.80), (0.45, 0.80)),
    },
    LOUD: {
        (RTLS, LS): ((0.81, 1.33), (0.84, 1.20)),
        (LS_ALL, LS): ((0.55, 1.05), (0.69, 1.08)),
        (GTLS, LS): ((0.34, 0.70), (0.37, 0.63)),
        (GTLS, RTLS): ((0.33, 0.65), (0.37, 0.63)),
        (GTLS_WINDOWED, RTLS): ((0.14, 0.28), (0.15, 0.30)),
        (GTLS_MODAL, RTLS): ((0.08, 0.17), (0.11, 0.22)),
        (GTLS_WINDOWED, RTLS_WINDOWED): ((0.41, 0.78), (0.43, 0.79)),
    },
    HAMMER: {
        (RTLS, LS): ((1.01, 1.38), (0.85, 1.11)),
        (LS_ALL, LS): ((1.14, 1.73), (0.92, 1.27)),
        (GTLS, LS): ((0.51, 0.91), (0.47, 0.82)),
        (GTLS, RTLS): ((0.42, 0.79), (0.46, 0.85)),
        (GTLS_WINDOWED, RTLS): ((0.07, 0.12), (0.07, 0.14)),
        (GTLS_MODAL, RTLS): ((0.14, 0.28), (0.12, 0.29)),
        (GTLS_WINDOWED, RTLS_WINDOWED): ((0.69, 1.82), (0.50, 0.92)),
    },
}
