/* SPDX-License-Identifier: Apache-2.0 */
/* Calls from Python that work on the results of the fit, not on counts. */

/* Whether a buffer has `size` bytes for each of some pixels. */
static int has_room(const Call *call, int buffer, size_t pixels, size_t size)
{
    return (size_t)call->held[buffer].len == size * pixels;
}

/* Begins a call without counts. */
static int begin_without_counts(Call *call, PyObject *args, int wanted, int reads)
{
    call->count = hold(args, call->held, wanted, reads, -1);
    return call->count == wanted;
}

/* Arguments that verdicts and picture begin with. */
_Static_assert((int)VERDICTS_RULES == (int)PICTURE_RULES && (int)VERDICTS_MISFIT == (int)PICTURE_MISFIT,
               "the delays come first");

/* The delays of fits, or of none if they do not fit one another. */
static Fits read_fits(const Call *call)
{
    const Py_buffer *held = call->held;
    size_t count = (size_t)held[PICTURE_DELAY_NS].len / 8;
    for (int buffer = PICTURE_DELAY_NS; buffer <= PICTURE_MISFIT; buffer++)
        if (!has_room(call, buffer, count, 8))
            return (Fits){0};
    return (Fits){.count = count, .delay = held[PICTURE_DELAY_NS].buf,
                  .deviation = held[PICTURE_DELAY_STD_NS].buf, .other = held[PICTURE_OTHER_NS].buf,
                  .detection = held[PICTURE_DETECTION].buf,
                  .chi_square = held[PICTURE_CHI_SQUARE].buf, .misfit = held[PICTURE_MISFIT].buf};
}

static int run_verdicts(Call *call)
{
    const Py_buffer *held = call->held;
    const PictureRules *rules = held[VERDICTS_RULES].buf;
    Fits fits = read_fits(call);
    if (held[VERDICTS_RULES].len != sizeof *rules || held[VERDICTS_TALLY].len != 24
        || !has_room(call, VERDICTS_METERS_PER_NS, fits.count, 8)
        || !has_room(call, VERDICTS_FLAGS, fits.count, 2))
        return refuse("verdicts: buffers do not fit one another");
    const double *along = held[VERDICTS_METERS_PER_NS].buf;
    uint16_t *flags = held[VERDICTS_FLAGS].buf;
    int64_t told = 0, above = 0, great = 0;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < fits.count; i++) {
        flags[i] = (uint16_t)verdict(rules, &fits, i, along[i]);
        if (is_untold(rules, flags[i]) || !isfinite(fits.chi_square[i]))
            continue;
        told++;
        above += fits.chi_square[i] > 1;
        great += fits.chi_square[i] > rules->plain_misfit;
    }
    Py_END_ALLOW_THREADS
    memcpy(held[VERDICTS_TALLY].buf, (int64_t[]){told, above, great}, 24);
    return 1;
}

static PyObject *py_verdicts(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin_without_counts(&call, args, VERDICTS_BUFFERS, VERDICTS_READS)
                          && run_verdicts(&call));
}

/* What is known of places, and where their results go; false if a buffer has no room. */
static int read_places(const Call *call, Conversion *c)
{
    const Py_buffer *held = call->held;
    size_t pixels = c->rules.pixels > 0 ? (size_t)c->rules.pixels : 0;
    size_t bands = (size_t)c->all.bands;
    int counted = c->rules.counted || c->rules.scaled;
    int lost = c->rules.scaled && !c->rules.pileup_correction;
    c->places = (Places){
        .photons = held[PICTURE_PHOTONS].buf, .exposures = held[PICTURE_EXPOSURES].buf,
        .along = held[PICTURE_METERS_PER_NS].buf, .base = held[PICTURE_BASE].buf,
        .delay_variance = held[PICTURE_DELAY_VARIANCE].buf,
        .brightness_variance = held[PICTURE_BRIGHTNESS_VARIANCE].buf,
        .flat_field = held[PICTURE_FLAT_FIELD].buf,
        .reference_loss = held[PICTURE_REFERENCE_LOSS].buf};
    c->numbers = held[PICTURE_NUMBERS].buf;
    c->values = held[PICTURE_REFLECTANCES].buf;
    c->deviations = c->values + pixels * bands;
    c->quality = held[PICTURE_QUALITY].buf;
    return pixels && has_room(call, PICTURE_PHOTONS, pixels, 8)
        && (!counted || has_room(call, PICTURE_EXPOSURES, pixels, 8))
        && (!lost || has_room(call, PICTURE_REFERENCE_LOSS, pixels, 8))
        && has_room(call, PICTURE_METERS_PER_NS, pixels, 8)
        && has_room(call, PICTURE_DELAY_VARIANCE, pixels, 8)
        && has_room(call, PICTURE_BRIGHTNESS_VARIANCE, pixels, 8)
        && has_room(call, PICTURE_FLAT_FIELD, pixels, 8) && has_room(call, PICTURE_BASE, pixels, 2)
        && has_room(call, PICTURE_NUMBERS, pixels, 8 * RESULT_PLANES)
        && has_room(call, PICTURE_REFLECTANCES, pixels, 8 * bands)
        && has_room(call, PICTURE_QUALITY, pixels, 2);
}

/* Whether pixels are in the picture, and their fits rise one by one. */
static int are_in_order(const Call *call, const Conversion *c, size_t pixels)
{
    const int64_t *places = call->held[PICTURE_PLACES].buf, *fits = call->held[PICTURE_FITS].buf;
    int64_t next = 0;
    for (size_t i = 0; i < pixels; i++) {
        if (places[i] < 0 || places[i] >= c->rules.pixels || (fits[i] >= 0 && fits[i] != next))
            return 0;
        next += fits[i] >= 0;
    }
    return next == (int64_t)c->fits.count;
}

/* Everything that a call of picture needs; false if its buffers do not fit one another. */
static int read_conversion(const Call *call, Conversion *c)
{
    const Py_buffer *held = call->held;
    size_t bands = (size_t)held[PICTURE_INVERSE].len / 8, count, pixels;
    const InformationScale *scale = held[PICTURE_SCALE].buf;
    if (held[PICTURE_RULES].len != sizeof c->rules || held[PICTURE_SCALE].len != sizeof *scale)
        return 0;
    *c = (Conversion){.rules = *(const PictureRules *)held[PICTURE_RULES].buf,
                      .fits = read_fits(call), .luck = held[PICTURE_LUCK].buf,
                      .tails = held[PICTURE_TAILS].buf,
                      .first_in_cell = held[PICTURE_LUCK_CELLS].buf,
                      .lucks = (int)(held[PICTURE_LUCK].len / 16),
                      .scores = (int)(held[PICTURE_TAILS].len / 8)};
    c->all = (Bands){.bands = (int)bands, .misfit = (float)c->rules.misfit};
    c->information = (Information){(int)bands, *scale, held[PICTURE_TABLE].buf, {0}};
    c->fits.flags = held[PICTURE_FLAGS].buf;
    c->fits.amplitudes = held[PICTURE_AMPLITUDES].buf;
    c->fits.amplitude_std = held[PICTURE_AMPLITUDE_STD].buf;
    c->fits.background = held[PICTURE_BACKGROUND].buf;
    count = c->fits.count;
    pixels = (size_t)held[PICTURE_PLACES].len / 8;
    return bands <= MOST_BANDS && scale->points >= 2 && c->lucks >= 2 && c->scores >= 2
        && has_room(call, PICTURE_LUCK_CELLS, LUCK_CELLS, 4)
        && has_room(call, PICTURE_UNCERTAINTY, bands, 8) && has_room(call, PICTURE_PLACEMENT, bands, 4)
        && has_room(call, PICTURE_TABLE, (size_t)scale->points, 4 * INFORMATION_COLUMNS * bands)
        && has_room(call, PICTURE_FLAGS, count, 2) && has_room(call, PICTURE_BACKGROUND, count, 8)
        && has_room(call, PICTURE_AMPLITUDES, count, 8 * bands)
        && has_room(call, PICTURE_AMPLITUDE_STD, count, 8 * bands)
        && has_room(call, PICTURE_FITS, pixels, 8) && read_places(call, c)
        && are_in_order(call, c, pixels);
}

static int run_picture(Call *call)
{
    Conversion conversion;
    if (!read_conversion(call, &conversion))
        return refuse("picture: buffers do not fit one another");
    size_t bands = (size_t)conversion.all.bands;
    narrow(call->held[PICTURE_INVERSE].buf, bands, conversion.all.inverse);
    narrow(call->held[PICTURE_UNCERTAINTY].buf, bands, conversion.all.uncertainty);
    memcpy(conversion.information.placement, call->held[PICTURE_PLACEMENT].buf, bands * sizeof(float));
    const int64_t *places = call->held[PICTURE_PLACES].buf, *fits = call->held[PICTURE_FITS].buf;
    size_t pixels = (size_t)call->held[PICTURE_PLACES].len / 8;
    Py_BEGIN_ALLOW_THREADS
    for (size_t i = 0; i < pixels; i += SOME_PIXELS)
        convert_pixels(&conversion, places + i, fits + i,
                       pixels - i < SOME_PIXELS ? (int)(pixels - i) : SOME_PIXELS);
    Py_END_ALLOW_THREADS
    return 1;
}

static PyObject *py_picture(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call, begin_without_counts(&call, args, PICTURE_BUFFERS, PICTURE_READS)
                          && run_picture(&call));
}

static int run_surface_starts(Call *call)
{
    const Py_buffer *held = call->held;
    const PictureSize *size = held[SURFACE_STARTS_SIZE].buf;
    if (held[SURFACE_STARTS_SIZE].len != sizeof *size || size->rows < WINDOW || size->cols < WINDOW)
        return refuse("surface_starts: the picture is smaller than a window");
    size_t pixels = (size_t)size->rows * (size_t)size->cols, room = 4 * (pixels + LANES);
    size_t rows = (size_t)(size->rows - WINDOW + 1), cols = (size_t)(size->cols - WINDOW + 1);
    if (!has_room(call, SURFACE_STARTS_DEPTH, pixels, 4)
        || !has_room(call, SURFACE_STARTS_DEVIATION, pixels, 4)
        || !has_room(call, SURFACE_STARTS_NEAR, rows * cols, 4)
        || !has_room(call, SURFACE_STARTS_FAR, rows * cols, 4))
        return refuse("surface_starts: buffers do not fit one another");
    call->block = malloc(4 * (room + 64) + 64);
    if (!allocated(call))
        return 0;
    char *place = (char *)(((uintptr_t)call->block + 63) / 64 * 64);
    Planes planes = {.rows = size->rows, .cols = size->cols};
    planes.depth = take(&place, room);
    planes.reach = take(&place, room);
    planes.weight = take(&place, room);
    planes.moment = take(&place, room);
    float *near = held[SURFACE_STARTS_NEAR].buf, *far = held[SURFACE_STARTS_FAR].buf;
    Py_BEGIN_ALLOW_THREADS
    fill_planes(&planes, held[SURFACE_STARTS_DEPTH].buf, held[SURFACE_STARTS_DEVIATION].buf,
                size->reach);
    for (size_t row = 0; row < rows; row++)
        surface_starts(&planes, (int)row, near + row * cols, far + row * cols);
    Py_END_ALLOW_THREADS
    return 1;
}

static PyObject *py_surface_starts(PyObject *self, PyObject *args)
{
    (void)self;
    Call call = {0};
    return end(&call,
               begin_without_counts(&call, args, SURFACE_STARTS_BUFFERS, SURFACE_STARTS_READS)
                   && run_surface_starts(&call));
}
