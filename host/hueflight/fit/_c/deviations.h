/* SPDX-License-Identifier: Apache-2.0 */
/* What a pixel's fit says in the end: parts of the variance of its delay, and its reflectances. The
 * definitions are deviations.py and reflectances.py of hueflight/reconstruction. */

/* What each band tells about the delay, over the ratio of its photons to those of background. */
typedef struct {
    int bands;
    InformationScale scale;
    const float *table;     /* (ratio, band, 4), see INFORMATION_COLUMNS of abi.h */
    const float *placement; /* (band,) variance of a waveform's place in time */
} Information;

enum { SOME_PIXELS = 32 }; /* that are worked on together */

/* For each of some pixels, the share of its information that noise adds, and the variance that the
 * waveforms' places add to that of its delay. */
APART void delay_noise(const Information *tables, int count, const double *amplitudes,
                       const double *deviations, const double *background, float *taken, float *added)
{
    enum { MOST_VALUES = SOME_PIXELS * MOST_BANDS + LANES };
    float ratios[MOST_VALUES], above[MOST_VALUES], noise[SOME_PIXELS * MOST_BANDS];
    int32_t below[MOST_VALUES];
    const InformationScale *scale = &tables->scale;
    int bands = tables->bands, values = count * bands;
    for (int i = 0; i < count; i++) {
        float dark = (float)background[i], inverse = 1 / (dark > 1 ? dark : 1);
        for (int at = i * bands; at < (i + 1) * bands; at++) {
            float amplitude = (float)amplitudes[at], deviation = (float)deviations[at] * inverse;
            ratios[at] = amplitude > 0 ? amplitude * inverse : 0;
            noise[at] = deviation * deviation;
        }
    }
    for (int at = values; at < values + LANES; at++)
        ratios[at] = 1;
    vec last = fill((float)(scale->points - 2));
    for (int at = 0; at < values; at += LANES) { /* where each ratio is in the tables */
        vec log = logarithm(greater(load(ratios + at), fill(scale->least)));
        vec place = (log - scale->first_log) * scale->per_log;
        ivec whole = __builtin_convertvector(lesser(place, last), ivec);
        vec part = lesser(place - __builtin_convertvector(whole, vec), fill(1));
        memcpy(below + at, &whole, sizeof whole);
        store(above + at, part);
    }
    for (int i = 0, at = 0; i < count; i++) {
        float total = 0, bias = 0, placed = 0;
        for (int k = 0; k < bands; k++, at++) {
            const float *row = tables->table + INFORMATION_COLUMNS * (below[at] * bands + k);
            float told = ratios[at] * ratios[at] * (row[0] + row[1] * above[at]);
            total += told;
            placed += told * told * tables->placement[k];
            bias += noise[at] * (row[2] + row[3] * above[at]);
        }
        total = 1 / (total > LEAST ? total : LEAST);
        taken[i] = bias * total;
        added[i] = placed * total * total;
    }
}

/* What all pixels of a call of reflectances share. */
typedef struct {
    int bands;
    double misfit;             /* factor of the variances of photon noise */
    const double *inverse;     /* (band,) 1 ÷ brightness */
    const double *uncertainty; /* (band,) relative variance of the brightness */
} Bands;

/* Reflectances of a pixel and their standard deviations: `gain` makes photons of a band with
 * brightness 1 to reflectance, `uncertainty` is the relative variance of what all bands share, and
 * `by_range` the relative deviation of the gain. */
INLINE void reflectances(const Bands *all, const double *amplitudes, const double *deviations,
                         double gain, double uncertainty, double by_range, float *value,
                         float *deviation)
{
    for (int k = 0; k < all->bands; k++) {
        double each = gain * all->inverse[k], amplitude = amplitudes[k];
        double variance = deviations[k] * deviations[k] * all->misfit
                        + amplitude * amplitude * (uncertainty + all->uncertainty[k]);
        double reflectance = each * amplitude, range = reflectance * by_range;
        value[k] = (float)reflectance;
        deviation[k] = (float)sqrt(each * each * variance + range * range);
    }
}
