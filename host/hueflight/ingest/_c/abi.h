/* SPDX-License-Identifier: Apache-2.0 */
/* Made by tools/generate_kernel_headers.py from hueflight/backend/ingest.py:
 * change that file and run the tool. */
#ifndef HUEFLIGHT_INGEST_ABI_H
#define HUEFLIGHT_INGEST_ABI_H
#include <stdint.h>

#define ABI "3722638f79d52dfb" /* hash of what follows */

enum { AT_TYPE = 5 };
enum { AT_HEADER_BYTES = 6 };
enum { AT_LENGTH = 8 };
enum { AT_SEQUENCE = 12 };
enum { AT_TIMESTAMP = 16 };
enum { AT_FRAME = 24 };
enum { AT_DROPPED = 36 };
enum { AT_ROWS = 40 };
enum { AT_COLS = 42 };
enum { AT_RUN = 44 };
enum { AT_CODE_BITS = 46 };
enum { AT_FLAGS = 48 };
enum { AT_STEP = 50 };
enum { AT_CAPTURE = 52 };
enum { MAGIC = 1702185127 };
enum { VERSION = 1 };
enum { FRAME = 1 };
enum { LAST_KNOWN_TYPE = 5 };
enum { FRAME_HEADER = 64 };
enum { FRAME_TRAILER = 16 };
enum { OTHER_HEADER = 32 };
enum { OTHER_TRAILER = 8 };
enum { MAX_HEADER = 256 };
enum { MAX_BODY = 1048576 };
enum { MAX_SIDE = 1024 };
enum { MAX_BITS = 16 };
enum { MIN_RUN = 8 };
enum { MAX_RUN = 4096 };
enum { MAX_CHUNKS = 16384 };
enum { KNOWN_FLAGS = 127 };
enum { PAD = 0 };
enum { BITMAP = 1 };
enum { DENSE = 2 };
enum { END = 3 };
enum { TILE = 64 }; /* pixels that are added to a histogram together or not at all */
enum { SCENE_TILE = 4 }; /* pixels on a side of a tile of the scene */
enum { SMOOTHINGS = 4 }; /* of counts, with both halves of neighbors */
enum { MOST_FRAMES = 65535 }; /* that the counters of a tile can hold */
enum { HITS_SHIFT = 32 }; /* in an entry of the table of chunks: offset, hits, kind */
enum { KIND_SHIFT = 48 };
enum { ADD = 0 };
enum { STORE = 1 };
enum { SATURATE = 2 };
enum { SUBTRACT = 3 };

/* What scanning carries from one piece of the stream to the next, and its totals. */
typedef struct {
    int64_t in_step;
    int64_t has_sequence;
    int64_t sequence;
    int64_t has_dropped;
    int64_t capture;
    int64_t last_dropped;
    int64_t packets;
    int64_t frames;
    int64_t aborted;
    int64_t repeated;
    int64_t foreign;
    int64_t damaged;
    int64_t skipped_bytes;
    int64_t missing;
    int64_t restarts;
    int64_t dropped;
    int64_t dropped_before;
    int64_t hits;
    int64_t foreign_rows;
    int64_t foreign_cols;
    int64_t foreign_bits;
    int64_t masked;
    int64_t roi;
    int64_t gated;
    int64_t saturated;
    int64_t test_pattern;
    int64_t simulated;
    int64_t trigger_lost;
} State;
_Static_assert(sizeof(State) == 224, "State is laid out as NumPy lays it out");

/* scan(data, start, final, rows, cols, code_bits, frames, limit, run, state, chunks, headers, places, others): position, frames, others, run, stride, needed, ended */
#define SCAN_ARGUMENTS "OnpiiinniOOOOO"

/* count(data, chunks, stride, chosen, pixels, code_bits, run, out, wide, mode, done, begin, end): photons, clipped, pending */
#define COUNT_ARGUMENTS "OOnOiiiOpiOnn"

/* group_counts(histogram, wide, rows, cols, codes, group, leave_first, out): None */
#define GROUP_COUNTS_ARGUMENTS "OpnnnnpO"

/* gather(total, total_wide, histogram, histogram_wide, anew, rows, cols, codes, out, out_wide): None */
#define GATHER_ARGUMENTS "OpOpOnnnOp"

/* significance(newest, earlier, ratio, rows, cols, groups, size, window, brightness_tolerance, shift_tolerance, out): None */
#define SIGNIFICANCE_ARGUMENTS "OOOnnnnnddO"

#endif
