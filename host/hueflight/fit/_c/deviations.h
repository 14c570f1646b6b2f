/* SPDX-License-Identifier: Apache-2.0 */
/* What a pixel's fit says in the end: parts of the variance of its delay, and its reflectances. The
 * definitions are deviations.py and reflectances.py of hueflight/reconstruction. */

enum {
    SOME_PIXELS = 32, /* that are worked on together, a multiple of the lanes of every build */
    SOME_VALUES = SOME_PIXELS * MOST_BANDS + LANES, /* of all their bands; whole vectors are read */
    BAND_ROOM = MOST_BANDS + LANES,
};

/* What each band tells about the delay, over the ratio of its photons to those of background. */
typedef struct {
    int bands;
    InformationScale scale;
    const float *table;     /* (ratio, band, 4), see INFORMATION_COLUMNS of abi.h */
    float placement[BAND_ROOM]; /* variance of each waveform's place in time */
} Information;

/* For each of some pixels, the share of its information that noise adds, and the variance that the
 * waveforms' places add to that of its delay. Amplitudes and their deviations are (pixel, band), and all
 * arrays have room for whole vectors. */
APART void delay_noise(const Information *tables, int count, const float *amplitudes,
                       const float *deviations, const double *background, double *taken,
                       double *added)
{
    float ratios[SOME_VALUES], above[SOME_VALUES], noise[SOME_VALUES];
    float told[SOME_VALUES], curved[SOME_VALUES];
    int32_t below[SOME_VALUES];
    const InformationScale *scale = &tables->scale;
    int bands = tables->bands, values = count * bands;
    for (int i = 0; i < count; i++) { /* what is written beyond a pixel's bands, the next one replaces */
        float dark = (float)background[i], inverse = 1 / (dark > 1 ? dark : 1);
        for (int k = 0; k < bands; k += LANES) {
            vec deviation = load(deviations + i * bands + k) * inverse;
            store(ratios + i * bands + k,
                  greater(load(amplitudes + i * bands + k), (vec){0}) * inverse);
            store(noise + i * bands + k, deviation * deviation);
        }
    }
    store(ratios + values, fill(1));
    vec last = fill((float)(scale->points - 2));
    for (int at = 0; at < values; at += LANES) { /* where each ratio is in the tables */
        vec log = logarithm(greater(load(ratios + at), fill(scale->least)));
        vec place = (log - scale->first_log) * scale->per_log;
        ivec whole = __builtin_convertvector(lesser(place, last), ivec);
        vec part = lesser(place - __builtin_convertvector(whole, vec), fill(1));
        whole *= bands;
        memcpy(below + at, &whole, sizeof whole);
        store(above + at, part);
    }
    for (int i = 0, at = 0; i < count; i++)
        for (int k = 0; k < bands; k++, at++) {
            const float *row = tables->table + INFORMATION_COLUMNS * (below[at] + k);
            told[at] = row[0] + row[1] * above[at];
            curved[at] = row[2] + row[3] * above[at];
        }
    for (int i = 0; i < count; i += LANES) { /* sums over the bands of a vector of pixels */
        vec totals[LANES], placed[LANES], biases[LANES];
        for (int lane = 0; lane < LANES; lane++) {
            int at = (i + lane < count ? i + lane : count - 1) * bands;
            totals[lane] = placed[lane] = biases[lane] = (vec){0};
            for (int k = 0; k < bands; k += LANES) {
                ivec some = lane_numbers() < bands - k;
                vec ratio = load(ratios + at + k);
                vec each = choose(some, ratio * ratio * load(told + at + k), (vec){0});
                totals[lane] += each;
                placed[lane] += each * each * load(tables->placement + k);
                biases[lane] += choose(some, load(noise + at + k) * load(curved + at + k), (vec){0});
            }
        }
        vec total = 1 / greater(sums(totals), fill(LEAST));
        vec bias = sums(biases) * total, place = sums(placed) * total * total;
        for (int lane = 0; lane < LANES; lane++) {
            taken[i + lane] = (double)bias[lane];
            added[i + lane] = (double)place[lane];
        }
    }
}

/* What all pixels of a call of reflectances share. */
typedef struct {
    int bands;
    float misfit;                 /* factor of the variances of photon noise */
    float inverse[BAND_ROOM];     /* 1 ÷ brightness of each band */
    float uncertainty[BAND_ROOM]; /* and its relative variance */
} Bands;

/* Reflectances of some pixels and their standard deviations, (pixel, band): `gain` makes photons of a
 * band with brightness 1 to reflectance, and `shared` is the relative variance of what all bands have
 * in common. All arrays have room for whole vectors. */
INLINE void reflectances(const Bands *all, int count, const float *amplitudes,
                         const float *deviations, const float *gain, const float *shared,
                         float *values, float *value_deviations)
{
    int bands = all->bands;
    for (int i = 0; i < count; i++) /* what is written beyond a pixel's bands, the next one replaces */
        for (int k = 0; k < bands; k += LANES) {
            vec each = gain[i] * load(all->inverse + k);
            vec amplitude = load(amplitudes + i * bands + k);
            vec deviation = load(deviations + i * bands + k);
            vec variance = deviation * deviation * all->misfit
                         + amplitude * amplitude * (shared[i] + load(all->uncertainty + k));
            store(values + i * bands + k, each * amplitude);
            store(value_deviations + i * bands + k, each * root(variance));
        }
}
