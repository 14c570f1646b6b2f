/* SPDX-License-Identifier: Apache-2.0 */
/* scan: find the packets in a piece of a byte stream and keep track of their sequence numbers.
 *
 * The rules are those of hueflight_protocol.PacketParser: after damage, the next magic number is
 * searched for from every byte on, including inside the damaged packet. Two rules about the content
 * are not checked here, because checking them would cost as much as counting: that padding bits are
 * 0 (F10), and that no packed code contradicts its chunk's hits (F11). A packet that passes its CRC
 * and breaks these rules comes from a faulty encoder. It cannot misplace the counts of other
 * pixels, and the report shows it as miscounted. */
typedef enum { GOOD, MORE, NO_HEADER, BAD } Verdict;

typedef struct {
    const uint8_t *data;
    size_t size;
    unsigned rows, cols, code_bits; /* other geometries are counted as foreign */
    State *state;
    uint64_t *chunks; /* (chunk, frame): see chunk_entry */
    size_t chunks_size, frame_limit;
    uint8_t *headers;  /* (frame, 64) */
    uint64_t *places;  /* (frame, 2): offset, size */
    uint64_t *others;  /* (packet, 2): offset, size of packets that are not frames */
    size_t others_limit;
    size_t frames, others_count;
    unsigned run;  /* pixels per chunk of these frames */
    size_t stride; /* frames per chunk in `chunks` */
    size_t needed; /* bytes needed from the current place on to make progress */
    int ended;     /* stopped because the data ended, not because a table is full */
} Scan;

INLINE uint64_t chunk_entry(size_t offset, unsigned hits, unsigned kind)
{
    return (uint64_t)offset | (uint64_t)hits << HITS_SHIFT | (uint64_t)kind << KIND_SHIFT;
}

/* Payload bytes of a chunk, and the number of hits from which it is dense (rule F9). */
typedef struct { unsigned pixels, bits, dense_from, map_bits; size_t dense_bytes; } Shape;

static Shape chunk_shape(unsigned pixels, unsigned bits)
{
    Shape shape = {pixels, bits, 1, (pixels + 7) / 8 * 8, ((size_t)pixels * bits + 31) / 32 * 4};
    int64_t spare = 8 * ((int64_t)shape.dense_bytes - 4 - (pixels + 7) / 8);
    shape.dense_from += spare > 0 ? (unsigned)(spare / bits) : 0;
    return shape;
}

INLINE size_t payload_bytes(const Shape *shape, unsigned hits, unsigned kind)
{
    if (kind == DENSE)
        return shape->dense_bytes;
    return (shape->map_bits + (size_t)hits * shape->bits + 31) / 32 * 4; /* on the critical path */
}

/* Check the header at p, of which `left` bytes are available, and store its size in *size. */
static Verdict check_header(Scan *scan, const uint8_t *p, size_t left, size_t *size)
{
    if (left < 8) {
        scan->needed = 8;
        return MORE;
    }
    unsigned type = p[AT_TYPE], bytes = load16(p + AT_HEADER_BYTES);
    unsigned due = type == FRAME ? FRAME_HEADER : OTHER_HEADER;
    int known = 1 <= type && type <= LAST_KNOWN_TYPE;
    if (p[4] != VERSION || (known && bytes != due) || bytes % 8 || bytes < OTHER_HEADER
        || bytes > MAX_HEADER)
        return NO_HEADER;
    if (left < bytes) {
        scan->needed = bytes;
        return MORE;
    }
    uint32_t check = 0;
    for (unsigned i = 0; i < bytes; i += 4)
        check ^= load32(p + i);
    *size = bytes;
    return check ? NO_HEADER : GOOD;
}

/* Go through the chunks of the frame packet at p and store the size of the packet in *size. */
static Verdict scan_frame(Scan *scan, const uint8_t *p, size_t left, int ours, size_t *size)
{
    unsigned rows = load16(p + AT_ROWS), cols = load16(p + AT_COLS), run = load16(p + AT_RUN);
    unsigned bits = p[AT_CODE_BITS];
    if (load32(p + AT_LENGTH) != STREAMED || rows < 1 || rows > MAX_SIDE || cols < 1
        || cols > MAX_SIDE || bits < 1 || bits > MAX_BITS || run % 8 || run < MIN_RUN
        || run > MAX_RUN || rows * cols > run * MAX_CHUNKS || load16(p + AT_FLAGS) & ~KNOWN_FLAGS)
        return BAD;
    unsigned count = (rows * cols + run - 1) / run, found = 0, next = 0;
    Shape inner = chunk_shape(run, bits), last = chunk_shape(rows * cols - (count - 1) * run, bits);
    uint64_t *entry = scan->chunks + scan->frames;
    enum { FETCHED = 512 };
    size_t at = FRAME_HEADER, base = (size_t)(p - scan->data), summed = 0;
    uint32_t hits = 0, crc = ~0u;
    for (;;) {
        /* The CRC is computed along with the chunks: it reads sequentially, so that the bytes are
         * already in the cache when a chunk word is read. */
        for (; at - summed >= 3 * LONG_LANE && left >= at; summed += 3 * LONG_LANE)
            crc = crc_more(crc, p + summed, 3 * LONG_LANE);
        if (left < at + 4) {
            scan->needed = at + 4;
            return MORE;
        }
        PREFETCH_NOW(p + at + FETCHED);
        uint32_t word = load32(p + at);
        unsigned kind = word & 3, index = word >> 2 & 0x3fff, here = word >> 16;
        if (kind == END)
            break;
        if (kind == PAD) {
            if (word || at % 8 == 0)
                return BAD;
            if (left < at + 8) {
                scan->needed = at + 8;
                return MORE;
            }
            if ((p[at + 4] & 3) != END)
                return BAD;
            at += 4;
            continue;
        }
        if (index >= count || index < next)
            return BAD;
        const Shape *shape = index == count - 1 ? &last : &inner;
        if (here < 1 || here > shape->pixels || (here >= shape->dense_from) != (kind == DENSE))
            return BAD;
        if (ours) {
            for (; next < index; next++)
                entry[next * scan->stride] = 0;
            entry[index * scan->stride] = chunk_entry(base + at + 4, here, kind);
        }
        next = index + 1;
        found++;
        hits += here;
        at += 4 + payload_bytes(shape, here, kind);
    }
    if (left < at + FRAME_TRAILER) {
        scan->needed = at + FRAME_TRAILER;
        return MORE;
    }
    uint32_t end = load32(p + at);
    *size = at + FRAME_TRAILER;
    if (at % 8 || (end >> 2 & 0x3fff) > 1 || end >> 16 != found || load32(p + at + 4) != hits
        || load32(p + at + 8) != *size / 4 || !crc_holds(crc, p + summed, *size - 4 - summed))
        return BAD;
    if (ours)
        for (; next < count; next++)
            entry[next * scan->stride] = 0;
    return GOOD;
}

static Verdict check_other(Scan *scan, const uint8_t *p, size_t left, size_t header, size_t *size)
{
    uint32_t length = load32(p + AT_LENGTH);
    if (length > MAX_BODY)
        return BAD;
    size_t padded = (length + 7) & ~(size_t)7;
    *size = header + padded + OTHER_TRAILER;
    if (left < *size) {
        scan->needed = *size;
        return MORE;
    }
    for (size_t i = length; i < padded; i++)
        if (p[header + i])
            return BAD;
    return load32(p + *size - 8) == *size / 4 && crc_holds(~0u, p, *size - 4)
        ? GOOD : BAD;
}

/* Account for a sequence number; return 0 if the packet repeats the previous one. */
static int track_sequence(State *state, uint32_t sequence)
{
    uint32_t gap = sequence - (uint32_t)state->sequence - 1;
    int first = !state->has_sequence;
    state->has_sequence = 1;
    state->sequence = sequence;
    if (first)
        return 1;
    if (gap == 0xffffffffu) {
        state->repeated++;
        return 0;
    }
    if (gap < 0x80000000u)
        state->missing += gap;
    else
        state->restarts++;
    return 1;
}

static void track_dropped(State *state, uint32_t capture, uint32_t dropped)
{
    int same_run = capture == state->capture && dropped >= state->last_dropped;
    if (!state->has_dropped)
        state->dropped_before = dropped;
    else
        state->dropped += same_run ? dropped - state->last_dropped : dropped;
    state->has_dropped = 1;
    state->capture = capture;
    state->last_dropped = dropped;
}

static void record_frame(Scan *scan, const uint8_t *p, size_t size, int ours)
{
    State *state = scan->state;
    track_dropped(state, load32(p + AT_CAPTURE), load32(p + AT_DROPPED));
    if (load32(p + size - FRAME_TRAILER) >> 2 & 1) {
        state->aborted++;
        return;
    }
    if (!ours) {
        state->foreign++;
        state->foreign_rows = load16(p + AT_ROWS);
        state->foreign_cols = load16(p + AT_COLS);
        state->foreign_bits = p[AT_CODE_BITS];
        return;
    }
    unsigned flags = load16(p + AT_FLAGS);
    state->masked += flags & 1;
    state->roi += flags >> 1 & 1;
    state->gated += flags >> 2 & 1;
    state->saturated += flags >> 3 & 1;
    state->test_pattern += flags >> 4 & 1;
    state->simulated += flags >> 5 & 1;
    state->trigger_lost += flags >> 6 & 1;
    state->hits += load32(p + size - FRAME_TRAILER + 4);
    state->frames++;
    memcpy(scan->headers + scan->frames * FRAME_HEADER, p, FRAME_HEADER);
    scan->places[2 * scan->frames] = (uint64_t)(p - scan->data);
    scan->places[2 * scan->frames + 1] = size;
    scan->frames++;
}

static size_t find_magic(const uint8_t *data, size_t at, size_t size)
{
    while (at < size) {
        const uint8_t *found = memchr(data + at, MAGIC & 255, size - at);
        if (!found)
            return size;
        at = (size_t)(found - data);
        size_t left = size - at < 4 ? size - at : 4;
        unsigned i = 1;
        while (i < left && found[i] == (MAGIC >> 8 * i & 255))
            i++;
        if (i == left)
            return at; /* the magic number, or its first bytes at the end of the piece */
        at++;
    }
    return size;
}

static int is_ours(const Scan *scan, const uint8_t *p)
{
    size_t run = load16(p + AT_RUN), pixels = (size_t)scan->rows * scan->cols;
    return load16(p + AT_ROWS) == scan->rows && load16(p + AT_COLS) == scan->cols
        && p[AT_CODE_BITS] == scan->code_bits && run && run % 8 == 0
        && (pixels + run - 1) / run <= scan->chunks_size;
}

/* Lay out `chunks` for another run length, which is possible only while it is empty. */
static int take_run(Scan *scan, unsigned run)
{
    if (scan->frames)
        return 0;
    scan->run = run;
    scan->stride = scan->chunks_size / (((size_t)scan->rows * scan->cols + run - 1) / run);
    return 1;
}

/* Go through the packets from `at` on and return where scanning stopped: at the end, at a full
 * table, or at a frame with another run length. With `final`, a packet that the end cuts short
 * counts as damaged. */
static size_t scan_packets(Scan *scan, size_t at, int final)
{
    State *state = scan->state;
    while (!(scan->frames && (scan->frames == scan->frame_limit || scan->frames == scan->stride))
           && scan->others_count < scan->others_limit) {
        size_t found = find_magic(scan->data, at, scan->size);
        if (found > at) {
            state->skipped_bytes += (int64_t)(found - at);
            state->in_step = 0;
            at = found;
        }
        const uint8_t *p = scan->data + at;
        size_t left = scan->size - at, size = 0;
        if (left < 4) {
            if (final) {
                state->skipped_bytes += (int64_t)left;
                state->in_step = 1;
                at = scan->size;
            }
            scan->needed = 8;
            scan->ended = 1;
            return at;
        }
        Verdict verdict = check_header(scan, p, left, &size);
        int frame = verdict == GOOD && p[AT_TYPE] == FRAME, ours = 0;
        if (frame) {
            ours = is_ours(scan, p);
            if (ours && load16(p + AT_RUN) != scan->run && !take_run(scan, load16(p + AT_RUN)))
                return at;
            verdict = scan_frame(scan, p, left, ours, &size);
        } else if (verdict == GOOD)
            verdict = check_other(scan, p, left, size, &size);

        if (verdict == MORE && !final) {
            scan->ended = 1;
            return at;
        }
        if (verdict != GOOD) {
            /* where no packet is expected, a magic number with an invalid header is data */
            state->damaged += state->in_step || verdict != NO_HEADER;
            state->skipped_bytes++;
            state->in_step = 0;
            at++;
            continue;
        }
        state->in_step = 1;
        state->packets++;
        if (track_sequence(state, load32(p + AT_SEQUENCE))) {
            if (frame)
                record_frame(scan, p, size, ours);
            else {
                scan->others[2 * scan->others_count] = at;
                scan->others[2 * scan->others_count++ + 1] = size;
            }
        }
        at += size;
    }
    return at;
}
