/* SPDX-License-Identifier: Apache-2.0 */
/* The tables of the fit as packing.py lays them out, and the state of pixels during the fit. */
#define MOST_SIZE (MOST_BANDS + 2)
#define TILE 64        /* pixels at once */
#define CANDIDATES (2 * TILE)
#define BATCH 4        /* pixels that are searched together */

/* Successive blocks of bins, a vector each, that one band lights. */
typedef struct {
    int32_t band, block, count, place; /* place of its first vector in a level's data */
} Run;

/* Successive blocks that two bands light. */
typedef struct {
    int32_t pair, block, count, one, other; /* places of their shares */
} Meeting;

typedef struct {
    int bins, blocks, phases;
    float first_ns, phase_ns;
    const float *widths;   /* blocks × lanes */
    const int32_t *places; /* phases + 1: first run of each phase */
    const Run *runs;
    const float *data;     /* of each run all shares, then all slopes */
    int pairs;
    const uint8_t *pair_bands; /* two bands of each pair that share a block, the greater first */
    const int32_t *meets;      /* phases + 1: first meeting of each phase */
    const Meeting *meetings;
} DelayTables;

typedef struct {
    int factor, bins, lags, separation;
    float first_ns, step_ns;
    const int32_t *span_places; /* lag blocks × bands + 1: first span of each band */
    const int32_t *spans;  /* spans × 3: first bin, one past the last, place in gains */
    const float *gains;    /* ratio × lags of a vector, for each bin of a span */
    const float *costs;    /* lag blocks × bands × ratios × lags of a vector */
    const int32_t *places; /* lags + 1: first run of each lag */
    const int32_t *runs;   /* band, first bin, one past the last */
    const float *widths, *shares; /* lags × bands */
} SearchTables;

typedef struct {
    int bands, views;
    const int32_t *sizes;  /* sensor's bins of each view */
    int factor, bins;      /* sensor's bins in a fine one; of all views */
    DelayTables fine, wide;
    SearchTables search;
    FitRules rules;
} ModelTables;

/* A delay that one pixel may have, with everything else that is fitted. */
typedef struct {
    int pixel, steps, live;
    float delay, background, cubic, variance;
    float amplitudes[MOST_BANDS], spread[MOST_BANDS], follow[MOST_BANDS + 1];
} Candidate;
