/* SPDX-License-Identifier: Apache-2.0 */
/* The tables of the fit as packing.py lays them out. */
#define MOST_SIZE (MOST_BANDS + 2)

/* Successive blocks of bins that one band lights. */
typedef struct {
    int32_t band, bin, bins, place; /* place of its first share in a level's data */
    int32_t lit_bin, lit_bins;      /* those with light */
} Run;

/* Successive bins that the same bands light. */
typedef struct {
    int32_t bin, bins, bands, lit; /* first of its bands in a level's table */
} Segment;

/* A band that lights a segment. */
typedef struct {
    int32_t band, shares, slopes; /* places in a level's data */
} Lit;

typedef struct {
    int bins, blocks, phases; /* blocks of LANES bins */
    float first_ns, phase_ns;
    float whole;               /* share of the background in all bins */
    const float *widths;       /* and in each bin */
    const int32_t *run_places; /* phases + 1: first run of each phase */
    const Run *runs;
    const float *data;         /* of each run all shares, then all slopes */
    const int32_t *segment_places; /* phases + 1: first segment of each phase */
    const Segment *segments;
    const Lit *lit;
    const float *sums; /* phases × bands × 2: sums of shares and slopes over bins */
} DelayTables;

typedef struct {
    int32_t band, first, last, place; /* bins up to `last`; place of its gains */
} GainRun;

typedef struct {
    int factor, bins, lags, separation;
    float first_ns, step_ns;
    const int32_t *gain_places; /* lags + 1: first run of each lag */
    const GainRun *gain_runs;
    const float *gains;    /* ratios for each bin of a run */
    const float *costs;    /* lags × bands × shares of background × ratios */
    const int32_t *places; /* lags + 1: first zone of each lag */
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

/* The tabulated delay that is nearest. */
INLINE int phase_of(const DelayTables *level, float delay)
{
    float place = (delay - level->first_ns) / level->phase_ns, last = (float)(level->phases - 1);
    place = place > 0 ? place < last ? place : last : 0;
    return (int)((place + 12582912.0f) - 12582912.0f); /* rounds numbers below 2²² */
}

INLINE float floor_of(const FitRules *rules, float total)
{
    return rules->floor_photons + rules->floor_share * total;
}

/* Expected counts of one pixel in all blocks, and with `slopes` their derivative by the delay. */
INLINE void expect(const DelayTables *level, int phase, const float *amplitudes, float background,
                   vec *means, vec *slopes)
{
    for (int v = 0; v < level->blocks; v++) {
        means[v] = background * load(level->widths + v * LANES) + LEAST;
        if (slopes)
            slopes[v] = (vec){0};
    }
    for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
        Run run = level->runs[i];
        const float *shares = level->data + run.place, *steep = shares + run.bins;
        float a = amplitudes[run.band];
        vec *mean = means + run.bin / LANES, *slope = slopes + run.bin / LANES;
        for (int v = 0; v * LANES < run.bins; v++) {
            mean[v] += a * load(shares + v * LANES);
            if (slopes)
                slope[v] += a * load(steep + v * LANES);
        }
    }
}
