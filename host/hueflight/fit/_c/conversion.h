/* SPDX-License-Identifier: Apache-2.0 */
/* From fits to a picture: flags, depth, reflectances and their deviations, at the places of the
 * pixels. The definition is conversion.py of hueflight/reconstruction. */

/* Fits as they are read. */
typedef struct {
    size_t count;
    const double *delay, *deviation, *other, *detection, *chi_square, *misfit;
    const double *amplitudes, *amplitude_std, *background;
    const uint16_t *flags;
} Fits;

/* What is known of each place of the picture. */
typedef struct {
    const double *photons, *exposures, *along, *delay_variance, *brightness_variance;
    const double *flat_field, *reference_loss;
    const uint16_t *base;
} Places;

/* What all pixels of a call share, and where their results go. */
typedef struct {
    PictureRules rules;
    Fits fits;
    Places places;
    Information information;
    Bands all;
    const double *luck, *tails;
    const int32_t *first_in_cell; /* of equal stretches of heights, the limit before each */
    int lucks, scores;
    double *numbers; /* (plane, place) */
    float *values, *deviations;
    uint16_t *quality;
} Conversion;

enum { DEPTH, DEPTH_STD, OTHER_DEPTH, BACKGROUND, PHOTONS, WHITE_PHOTONS, CHI_SQUARE, P_VALUE };
_Static_assert(P_VALUE + 1 == (int)RESULT_PLANES, "planes are those of result_planes.py");

/* Whether flags of a fit leave its depth untold. */
INLINE int is_untold(const PictureRules *rules, int flags)
{
    return (flags & (rules->low_signal | rules->no_return | rules->out_of_range)) != 0;
}

/* Flags of a fit: why its depth is not told, or what else is wrong with it. */
INLINE int verdict(const PictureRules *rules, const Fits *fits, size_t i, double along)
{
    double delay = fits->delay[i], guess = rules->distance + delay * along;
    int behind = rules->distance > 0 && guess <= 0, flags = 0;
    if (!(fits->deviation[i] < rules->blind_ns))
        flags |= rules->low_signal;
    if (fits->detection[i] < rules->least_detection)
        flags |= rules->no_return;
    else if (delay <= rules->low_ns || delay >= rules->high_ns || behind)
        flags |= rules->out_of_range;
    if (flags)
        return flags;
    if (isfinite(fits->other[i]))
        flags |= rules->ambiguous;
    if (fits->misfit[i] > rules->misfit_limit)
        flags |= rules->misfit_flag;
    return flags;
}

/* Detection ratio as it came out, over what is likely given that it passed the test. */
INLINE double luck_factor(const Conversion *c, double detection)
{
    int last = c->lucks - 1, low = 0;
    const double *beyond = c->luck, *limit = beyond + c->lucks;
    double least = c->rules.least_detection, root = sqrt(least), most = root + beyond[last];
    if (!(detection > 0 && detection < most * most))
        return 1;
    double seen = sqrt(detection > least ? detection : least), height = seen - root;
    double cell = (height - beyond[0]) * c->rules.cells_per_height;
    if (cell > 0)
        low = c->first_in_cell[cell < LUCK_CELLS - 1 ? (int)cell : LUCK_CELLS - 1];
    while (low < last - 1 && beyond[low + 1] <= height)
        low++;
    int high = low + 1;
    double part = (height - beyond[low]) / (beyond[high] - beyond[low]);
    part = part > 0 ? part < 1 ? part : 1 : 0;
    double likely = root - (limit[low] + part * (limit[high] - limit[low]));
    double ratio = seen / (likely < seen ? likely : seen);
    return ratio * ratio;
}

/* Probability of a misfit score as great as this. */
INLINE double tail_probability(const Conversion *c, double score)
{
    const PictureRules *rules = &c->rules;
    if (!(score <= rules->last_tail))
        return score > rules->last_tail ? 0 : NAN;
    double place = (score - rules->first_tail) / rules->tail_step, most = c->scores - 2;
    int below = (int)(place > 0 ? place < most ? place : most : 0);
    double part = place - below, log = c->tails[below];
    part = part > 0 ? part < 1 ? part : 1 : 0;
    return exp(log + part * (c->tails[below + 1] - log));
}

/* Photons that arrived in an exposure, where only the first is recorded, per recorded one. */
INLINE double loss_factor(double occupancy)
{
    double factor = occupancy == 0 ? 1 : -log1p(-occupancy) / occupancy;
    return isfinite(factor) ? factor : NAN;
}

/* What the correction of lost photons adds to the relative variance of all bands together. With r
 * arrivals of which the share x was recorded, (sinh(r/2) / (r/2))² is x² / ((1 − x) r²). */
INLINE double loss_variance(const PictureRules *rules, double photons, double exposures)
{
    double least = exposures - 0.5, recorded = photons < least ? photons : least;
    recorded = (recorded > 0 ? recorded : 0) / (exposures > 1e-300 ? exposures : 1e-300);
    if (rules->periods <= 1 || recorded <= 0)
        return 0;
    double arrivals = -log1p(-recorded), half = arrivals / rules->periods / 2;
    double whole = recorded * recorded / ((1 - recorded) * arrivals * arrivals);
    double square = half * half, within = 1 + square / 3 + square * square * (2.0 / 45);
    if (half > 1e-3)
        within = sinh(half) / half * (sinh(half) / half);
    return (whole > within ? whole - within : 0) / (photons > 1 ? photons : 1);
}

/* Factor from photons at a place to photons per exposure of an average pixel. */
INLINE double photon_scale(const Conversion *c, size_t at)
{
    const Places *places = &c->places;
    if (!c->rules.scaled)
        return 1 / places->flat_field[at];
    double exposures = places->exposures[at];
    if (!(exposures > c->rules.fewest_exposures))
        return NAN;
    double loss = c->rules.pileup_correction ? loss_factor(places->photons[at] / exposures)
                                             : places->reference_loss[at];
    return 1 / (places->flat_field[at] * exposures) * loss;
}

/* Flags of a place that its number of photons sets. */
INLINE int crowded(const PictureRules *rules, double photons, double exposures)
{
    double least = exposures - 0.5, seen = photons < least ? photons : least;
    int closed = seen > rules->most_closed * (exposures > 0 ? exposures : 0);
    int flags = closed || exposures - photons < rules->least_empty * exposures ? rules->piled_up : 0;
    return rules->pileup_correction && photons >= exposures ? flags | rules->saturated : flags;
}

/* Results of a pixel without a fit, and what others have in common with it; returns its scale. */
INLINE double convert_place(const Conversion *c, size_t at, int flags)
{
    const PictureRules *rules = &c->rules;
    size_t plane = (size_t)rules->pixels;
    double *numbers = c->numbers + at, scale = photon_scale(c, at), photons = c->places.photons[at];
    int base = c->places.base[at];
    if (!base && rules->counted)
        flags |= crowded(rules, photons, c->places.exposures[at]);
    c->quality[at] = (uint16_t)(base | flags);
    for (int name = 0; name < RESULT_PLANES; name++)
        numbers[name * plane] = NAN;
    numbers[PHOTONS * plane] = photons;
    numbers[WHITE_PHOTONS * plane] = rules->range_correction ? NAN : rules->brightness / scale;
    return scale;
}

/* Results of a pixel with a fit, of which `taken` and `added` are parts of the delay's variance. */
INLINE void convert_fit(const Conversion *c, size_t at, size_t fit, double taken, double added)
{
    const PictureRules *rules = &c->rules;
    const Fits *fits = &c->fits;
    int flags = fits->flags[fit], bands = c->all.bands;
    size_t plane = (size_t)rules->pixels;
    double *numbers = c->numbers + at, scale = convert_place(c, at, flags);
    double along = c->places.along[at], guess = rules->distance + fits->delay[fit] * along;
    double variance = fits->deviation[fit] * fits->deviation[fit] * rules->misfit;
    variance *= sqrt(luck_factor(c, fits->detection[fit]));
    if (taken > rules->least_bias)
        variance /= 1 - (taken < rules->most_bias ? taken : rules->most_bias);
    double depth_std = sqrt(variance + added + c->places.delay_variance[at]) * along, by_range = 0;
    numbers[BACKGROUND * plane] = fits->background[fit] * rules->background_scale;
    if (rules->range_correction) {
        double range = rules->distance > 0 ? guess / rules->distance : NAN;
        scale *= range * range;
        by_range = 2 * depth_std / fabs(guess);
        numbers[WHITE_PHOTONS * plane] = rules->brightness / scale;
    }
    float *values = c->values + at * (size_t)bands, *deviations = c->deviations + at * (size_t)bands;
    if (is_untold(rules, flags)) {
        for (int k = 0; k < bands; k++)
            values[k] = deviations[k] = NAN;
        return;
    }
    numbers[DEPTH * plane] = guess;
    numbers[DEPTH_STD * plane] = depth_std;
    numbers[OTHER_DEPTH * plane] = rules->distance + fits->other[fit] * along;
    numbers[CHI_SQUARE * plane] = fits->chi_square[fit];
    numbers[P_VALUE * plane] = tail_probability(c, fits->misfit[fit]);
    double shared = c->places.brightness_variance[at];
    if (rules->counted && rules->pileup_correction)
        shared += loss_variance(rules, c->places.photons[at], c->places.exposures[at]);
    reflectances(&c->all, fits->amplitudes + fit * (size_t)bands,
                 fits->amplitude_std + fit * (size_t)bands, scale, shared, by_range, values,
                 deviations);
}

/* Results of some pixels, at most SOME_PIXELS. */
APART void convert_pixels(const Conversion *c, const int64_t *places, const int64_t *fits, int count)
{
    float taken[SOME_PIXELS], added[SOME_PIXELS];
    size_t first = 0, bands = (size_t)c->all.bands;
    int fitted = 0;
    for (int i = 0; i < count; i++)
        if (fits[i] >= 0 && fitted++ == 0)
            first = (size_t)fits[i];
    if (fitted)
        delay_noise(&c->information, fitted, c->fits.amplitudes + first * bands,
                    c->fits.amplitude_std + first * bands, c->fits.background + first, taken, added);
    for (int i = 0; i < count; i++) {
        size_t at = (size_t)places[i], fit = (size_t)fits[i];
        if (fits[i] >= 0) {
            convert_fit(c, at, fit, taken[fit - first], added[fit - first]);
            continue;
        }
        convert_place(c, at, c->places.base[at] ? 0 : c->rules.low_signal);
        for (size_t k = 0; k < bands; k++)
            c->values[at * bands + k] = c->deviations[at * bands + k] = NAN;
    }
}
