/* The tables of a plan, and what pixels are on their way through the fit. See plan.py and fit.py:
 * these are the definition, names here are theirs. */
#define MOST_BANDS 30
#define MOST_SIZE (MOST_BANDS + 2)
#define TILE 64        /* pixels at once */
#define TRACKS (2 * TILE)
#define RATIOS 3
#define SHARES 3

typedef struct {
    int factor;            /* finer bins that each bin sums */
    int bins, blocks, phases;
    float first_ns, phase_ns;
    const float *widths;   /* blocks × 16 */
    const int32_t *places; /* phases × (blocks + 1): first entry of each block */
    const uint8_t *owners; /* band of each entry */
    const float *data;     /* shares and slopes of each entry, 16 each */
} Level;

typedef struct {
    int factor, bins, lags, separation;
    float first_ns, step_ns;
    const int32_t *spans;  /* lag blocks × bands × 3: first bin, one past the last, place in gains */
    const float *gains;    /* ratio × 16 lags for each bin of a span */
    const float *costs;    /* lag blocks × bands × ratios × 16 */
    const int8_t *owners;  /* lags × bins: band of each bin, or −1 */
    const float *widths, *shares; /* lags × bands */
} Coarse;

typedef struct {
    float shares[SHARES], logs[SHARES];
    int steps, nodes, rounds;
    float settled, floor_photons, floor_share, ridge, margin, ambiguous, few, spacing;
    float spread_ns, low_ns, high_ns, target_ns, raster;
    int halves, settle, posterior;
} Rules;

typedef struct {
    int bands, views;
    const int32_t *sizes;  /* sensor's bins of each view */
    int factor, bins;      /* sensor's bins in a fine one; of all views */
    Level fine, half;
    Coarse coarse;
    Rules rules;
} Plan;

/* One delay on trial for one pixel. */
typedef struct {
    int pixel, steps, live;
    float delay, background, cubic, variance;
    float amplitudes[MOST_BANDS], spread[MOST_BANDS], follow[MOST_BANDS + 1];
} Track;
