/* Envelopes, pieces and heads of links, as SPEC.md of aiorts_zenoh says. For little-endian and big-endian machines. */

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { FRAME = 1, PIECE, TAKEN, LOOK, END, HAVE };
enum { HELLO = 1, DATA, ACK, BYE, WANT, NONE };
#define HEAD 24
#define MOST 16

typedef struct {
    const uint8_t *bytes;
    uint32_t size;
} block_t;

typedef struct {
    unsigned kind, count;
    uint32_t epoch;
    uint64_t first;
    int64_t sent_ns;
    block_t blocks[MOST];
} message_t;

typedef struct {
    unsigned kind, flags, count;
    uint32_t link;
    uint64_t one, two;
} head_t;

static void put_number(uint8_t *to, uint64_t value, int size) {
    for (int place = 0; place < size; place++) to[place] = (uint8_t)(value >> (8 * place));
}

static uint64_t number_at(const uint8_t *from, int size) {
    uint64_t value = 0;
    for (int place = size; place--;) value = value << 8 | from[place];
    return value;
}

/* Writes a message; returns its size. */
static size_t put_message(uint8_t *to, const message_t *message) {
    to[0] = 1;
    to[1] = (uint8_t)message->kind;
    put_number(to + 2, message->count, 2);
    put_number(to + 4, message->epoch, 4);
    put_number(to + 8, message->first, 8);
    put_number(to + 16, (uint64_t)message->sent_ns, 8);
    size_t size = HEAD;
    for (unsigned place = 0; place < message->count; place++) {
        const block_t *block = &message->blocks[place];
        put_number(to + size, block->size, 4);
        if (block->size) memcpy(to + size + 4, block->bytes, block->size);
        size += 4 + block->size;
    }
    return size;
}

/* Finds so many blocks in bytes; returns whether they are all there, and nothing behind them. */
static int find_blocks(const uint8_t *bytes, size_t size, unsigned count, block_t *blocks) {
    size_t place = 0;
    if (count > MOST) return 0;
    for (unsigned number = 0; number < count; number++) {
        if (size - place < 4) return 0;
        uint32_t length = (uint32_t)number_at(bytes + place, 4);
        place += 4;
        if (size - place < length) return 0;
        blocks[number] = (block_t){bytes + place, length};
        place += length;
    }
    return place == size;
}

/* Reads a message; returns whether it is one. */
static int find_message(const uint8_t *bytes, size_t size, message_t *message) {
    if (size < HEAD || bytes[0] != 1 || bytes[1] < FRAME || bytes[1] > HAVE) return 0;
    message->kind = bytes[1];
    message->count = (unsigned)number_at(bytes + 2, 2);
    message->epoch = (uint32_t)number_at(bytes + 4, 4);
    message->first = number_at(bytes + 8, 8);
    message->sent_ns = (int64_t)number_at(bytes + 16, 8);
    return find_blocks(bytes + HEAD, size - HEAD, message->count, message->blocks);
}

static uint64_t cost_of(uint64_t size) { return size <= 64500 ? 2 * size : (1 + (size + 65399) / 65400) * 65536; }

/* Writes the head of a frame of a link; returns its size. */
static size_t put_head(uint8_t *to, const head_t *head) {
    to[0] = (uint8_t)head->kind;
    to[1] = (uint8_t)head->flags;
    put_number(to + 2, head->count, 2);
    put_number(to + 4, head->link, 4);
    if (head->kind == BYE) return 8;
    put_number(to + 8, head->one, 8);
    put_number(to + 16, head->two, 8);
    return HEAD;
}

/* Reads the head of a frame of a link; returns its size, 0 when it is none. */
static size_t find_head(const uint8_t *bytes, size_t size, head_t *head) {
    int is_short = size == 8 && bytes[0] == BYE;
    if (size < HEAD && !is_short) return 0;
    head->kind = bytes[0];
    head->flags = bytes[1];
    head->count = (unsigned)number_at(bytes + 2, 2);
    head->link = (uint32_t)number_at(bytes + 4, 4);
    head->one = is_short ? 0 : number_at(bytes + 8, 8);
    head->two = is_short ? 0 : number_at(bytes + 16, 8);
    return is_short ? 8 : HEAD;
}

/* A frame that comes in pieces. */
typedef struct {
    uint8_t *bytes;
    uint64_t size, total;
} whole_t;

/* Adds the two blocks of a piece; returns the count of blocks of the frame that is whole now, else 0. */
static unsigned add_piece(whole_t *whole, const block_t *piece, block_t *blocks) {
    uint64_t total = number_at(piece[0].bytes, 8), place = number_at(piece[0].bytes + 8, 8);
    if (place == 0) {
        free(whole->bytes);
        whole->bytes = malloc(total);
        whole->size = 0;
        whole->total = total;
    }
    if (place != whole->size || total != whole->total || piece[1].size > total - place) {
        whole->size = whole->total = 0;
        return 0;
    }
    memcpy(whole->bytes + place, piece[1].bytes, piece[1].size);
    whole->size += piece[1].size;
    if (whole->size < total) return 0;
    unsigned count = (unsigned)number_at(whole->bytes, 4);
    whole->size = whole->total = 0;
    return find_blocks(whole->bytes + 4, total - 4, count, blocks) ? count : 0;
}
