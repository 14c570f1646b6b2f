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

/* Logarithm of the probability of a misfit score as great as this. */
INLINE double tail_logarithm(const Conversion *c, double score)
{
    const PictureRules *rules = &c->rules;
    if (!(score <= rules->last_tail))
        return score > rules->last_tail ? -INFINITY : (double)NAN;
    double place = (score - rules->first_tail) / rules->tail_step, most = c->scores - 2;
    int below = (int)(place > 0 ? place < most ? place : most : 0);
    double part = place - below, log = c->tails[below];
    part = part > 0 ? part < 1 ? part : 1 : 0;
    return log + part * (c->tails[below + 1] - log);
}

/* Flags of a place that its number of photons sets. */
INLINE int crowded(const PictureRules *rules, double photons, double exposures)
{
    double least = exposures - 0.5, seen = photons < least ? photons : least;
    int closed = seen > rules->most_closed * (exposures > 0 ? exposures : 0);
    int flags = closed || exposures - photons < rules->least_empty * exposures ? rules->piled_up : 0;
    return rules->pileup_correction && photons >= exposures ? flags | rules->saturated : flags;
}

typedef double Row[SOME_PIXELS] __attribute__((aligned(64)));

/* Numbers of pixels, or of their fits: -1 where there is none. */
typedef struct {
    const int64_t *numbers;
    int count, together; /* whether they are a whole SOME_PIXELS that follow one another */
} Which;

INLINE Which which_of(const int64_t *numbers, int count)
{
    int64_t apart = numbers[0] < 0 || count < SOME_PIXELS;
    for (int i = 0; i < count; i++)
        apart |= numbers[i] - numbers[0] - i;
    return (Which){numbers, count, apart == 0};
}

/* Makes up a row to whole vectors. */
INLINE void fill_row(double *row, int count)
{
    for (int i = count; i % ABREAST; i++)
        row[i] = row[0];
}

/* Numbers of some pixels side by side, where they are or in `room`; NaN where there are none. */
INLINE const double *row_from(const double *all, const Which *which, double *room)
{
    if (which->together)
        return all + which->numbers[0];
    for (int i = 0; i < which->count; i++)
        room[i] = which->numbers[i] < 0 ? (double)NAN : all[which->numbers[i]];
    fill_row(room, which->count);
    return room;
}

/* Doubles to floats. */
INLINE void narrow(const double *from, size_t count, float *to)
{
    for (size_t i = 0; i < count; i++)
        to[i] = (float)from[i];
}

/* Numbers of all bands as floats, (pixel, band); those of the next pixels are fetched. */
INLINE void narrow_rows(const double *all, const Which *fits, size_t bands, float *to)
{
    if (fits->together) {
        const double *from = all + (size_t)fits->numbers[0] * bands;
        narrow(from, SOME_PIXELS * bands, to);
        for (size_t k = 0; k < SOME_PIXELS * bands; k += 8)
            __builtin_prefetch(from + SOME_PIXELS * bands + k);
    } else
        for (int i = 0; i < fits->count; i++)
            for (size_t k = 0; k < bands; k++)
                to[(size_t)i * bands + k] =
                    fits->numbers[i] < 0 ? NAN : (float)all[(size_t)fits->numbers[i] * bands + k];
    memset(to + (size_t)fits->count * bands, 0, LANES * sizeof *to);
}

/* What the correction of lost photons adds to the relative variance of all bands together. With r
 * arrivals of which the share x was recorded, (sinh(r/2) / (r/2))² is x² / ((1 − x) r²). */
INLINE vec_d loss_variance(const PictureRules *rules, vec_d photons, vec_d exposures)
{
    vec_d recorded = greater_d(lesser_d(photons, exposures - 0.5), (vec_d){0});
    recorded /= greater_d(exposures, fill_d(1e-300));
    vec_d arrivals = lost_logarithm(recorded), half = arrivals / (2 * rules->periods);
    vec_d whole = recorded * recorded / ((1 - recorded) * arrivals * arrivals);
    vec_d square = half * half, within = fill_d(1); /* (sinh(half) / half)² as a series */
    for (int n = 16; n > 0; n--)
        within = 1 + square * (4.0 / ((2 * n + 1) * (2 * n + 2))) * within;
    vec_d added = greater_d(whole - within, (vec_d){0}) / greater_d(photons, fill_d(1));
    return choose_d(recorded > 0, added, (vec_d){0});
}

/* Factor from photons at a place to photons per exposure of an average pixel. */
INLINE vec_d photon_scale(const Conversion *c, vec_d photons, vec_d exposures, vec_d flat_field,
                          vec_d loss)
{
    if (!c->rules.scaled)
        return 1 / flat_field;
    if (c->rules.pileup_correction) {
        vec_d occupancy = photons / exposures, arrivals = lost_logarithm(occupancy);
        loss = choose_d(occupancy == 0, fill_d(1), arrivals / occupancy);
        loss = choose_d(loss < INFINITY, loss, fill_d(NAN));
    }
    return choose_d(exposures > c->rules.fewest_exposures, loss / (flat_field * exposures),
                    fill_d(NAN));
}

/* What is computed of some pixels side by side, besides the numbers of the picture. */
typedef struct {
    Row luck, tail, taken, added;
    Row untold; /* 0, or NaN where the depth is not told */
    float gain[SOME_PIXELS], uncertainty[SOME_PIXELS];
    float amplitudes[SOME_VALUES], deviations[SOME_VALUES];
} Workspace;

/* Sets flags, and looks up in tables what belongs to a pixel. */
INLINE void look_up(const Conversion *c, const Which *places, const Which *fits, Workspace *w)
{
    const PictureRules *rules = &c->rules;
    for (int i = 0; i < places->count; i++) {
        size_t at = (size_t)places->numbers[i], fit = (size_t)fits->numbers[i];
        int fitted = fits->numbers[i] >= 0, base = c->places.base[at];
        int flags = fitted ? c->fits.flags[fit] : base ? 0 : rules->low_signal;
        w->untold[i] = fitted && !is_untold(rules, flags) ? 0 : (double)NAN;
        w->luck[i] = fitted ? luck_factor(c, c->fits.detection[fit]) : 1;
        w->tail[i] = fitted ? tail_logarithm(c, c->fits.misfit[fit]) : (double)NAN;
        if (!base && rules->counted)
            flags |= crowded(rules, c->places.photons[at], c->places.exposures[at]);
        c->quality[at] = (uint16_t)(base | flags);
    }
    fill_row(w->untold, places->count);
    fill_row(w->luck, places->count);
    fill_row(w->tail, places->count);
}

/* Computes the rows of numbers `to` of the picture, and what reflectances need. */
INLINE void convert_numbers(const Conversion *c, const Which *places, const Which *fits, Workspace *w,
                            double *const *to)
{
    const PictureRules *rules = &c->rules;
    const Places *known = &c->places;
    const Fits *found = &c->fits;
    int exposed = rules->counted || rules->scaled, lost = rules->scaled && !rules->pileup_correction;
    Row room[10];
    const double *photons_at = row_from(known->photons, places, room[0]);
    const double *exposures_at = exposed ? row_from(known->exposures, places, room[1]) : photons_at;
    const double *flat_field = row_from(known->flat_field, places, room[2]);
    const double *losses = lost ? row_from(known->reference_loss, places, room[3]) : photons_at;
    const double *along_axis = row_from(known->along, places, room[4]);
    const double *delay_variance = row_from(known->delay_variance, places, room[5]);
    const double *brightness_variance = row_from(known->brightness_variance, places, room[6]);
    const double *delays = row_from(found->delay, fits, room[7]);
    const double *delay_deviations = row_from(found->deviation, fits, room[8]);
    const double *others = row_from(found->other, fits, room[9]);
    for (int i = 0; i < places->count; i += ABREAST) {
        vec_d photons = load_d(photons_at + i), exposures = load_d(exposures_at + i);
        vec_d along = load_d(along_axis + i), untold = load_d(w->untold + i);
        vec_d shared = load_d(brightness_variance + i), by_range = {0};
        vec_d scale = photon_scale(c, photons, exposures, load_d(flat_field + i),
                                   load_d(losses + i));
        vec_d guess = rules->distance + load_d(delays + i) * along;
        vec_d deviation = load_d(delay_deviations + i), taken = load_d(w->taken + i);
        vec_d variance = deviation * deviation * rules->misfit * root_d(load_d(w->luck + i));
        vec_d left = 1 - lesser_d(taken, fill_d(rules->most_bias));
        variance = choose_d(taken > rules->least_bias, variance / left, variance);
        variance += load_d(w->added + i) + load_d(delay_variance + i);
        vec_d depth_std = root_d(variance) * along;
        if (rules->range_correction) {
            vec_d range = rules->distance > 0 ? guess / rules->distance : fill_d(NAN);
            scale *= range * range;
            by_range = 2 * depth_std / guess; /* whose sign is lost in its square */
        }
        if (rules->counted && rules->pileup_correction && rules->periods > 1)
            shared += loss_variance(rules, photons, exposures);
        shared += by_range * by_range;
        vec_d tail = load_d(w->tail + i);
        tail = choose_d(tail < -1400, (vec_d){0}, exponential_d(tail));
        store_d(to[DEPTH] + i, guess + untold);
        store_d(to[DEPTH_STD] + i, depth_std + untold);
        store_d(to[OTHER_DEPTH] + i, rules->distance + load_d(others + i) * along + untold);
        store_d(to[PHOTONS] + i, photons);
        store_d(to[WHITE_PHOTONS] + i, rules->brightness / scale);
        store_d(to[P_VALUE] + i, tail + untold);
        scale += untold;
        for (int lane = 0; lane < ABREAST; lane++) {
            w->gain[i + lane] = (float)scale[lane];
            w->uncertainty[i + lane] = (float)shared[lane];
        }
    }
}

/* Results of some pixels, at most SOME_PIXELS. */
APART void convert_pixels(const Conversion *c, const int64_t *numbers, const int64_t *fit_numbers,
                          int count)
{
    Workspace workspace, *w = &workspace;
    Which places = which_of(numbers, count), fits = which_of(fit_numbers, count);
    float values[SOME_VALUES], deviations[SOME_VALUES];
    size_t plane = (size_t)c->rules.pixels, bands = (size_t)c->all.bands;
    Row room[RESULT_PLANES], dark, chi;
    double *to[RESULT_PLANES];
    for (size_t name = 0; name < RESULT_PLANES; name++)
        to[name] = places.together ? c->numbers + name * plane + numbers[0] : room[name];
    const double *background = row_from(c->fits.background, &fits, dark);
    const double *chi_square = row_from(c->fits.chi_square, &fits, chi);
    narrow_rows(c->fits.amplitudes, &fits, bands, w->amplitudes);
    narrow_rows(c->fits.amplitude_std, &fits, bands, w->deviations);
    look_up(c, &places, &fits, w);
    delay_noise(&c->information, count, w->amplitudes, w->deviations, background, w->taken, w->added);
    convert_numbers(c, &places, &fits, w, to);
    for (int i = 0; i < count; i++) {
        to[BACKGROUND][i] = background[i] * c->rules.background_scale;
        to[CHI_SQUARE][i] = chi_square[i] + w->untold[i];
    }
    reflectances(&c->all, count, w->amplitudes, w->deviations, w->gain, w->uncertainty, values,
                 deviations);
    if (!places.together)
        for (size_t name = 0; name < RESULT_PLANES; name++)
            for (int i = 0; i < count; i++)
                c->numbers[name * plane + (size_t)numbers[i]] = room[name][i];
    for (int i = 0, some = count; i < count; i += some) {
        size_t at = (size_t)numbers[i] * bands, from = (size_t)i * bands;
        some = places.together ? count : 1;
        memcpy(c->values + at, values + from, (size_t)some * bands * sizeof(float));
        memcpy(c->deviations + at, deviations + from, (size_t)some * bands * sizeof(float));
    }
}
