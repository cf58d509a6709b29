/* Speaks with kernels of aiorts as SPEC.md of aiorts_zenoh says, with zenoh-pico alone.

   foreign_client HOST:PORT HOST KERNEL

   It connects to a router or kernel there and is the kernel HOST/KERNEL with one component, `twin`: out-port `out`,
   in-port `inp` (both TimedLong), parameter `step`; while it is active, `out` counts in these steps. A line on standard
   input has it do something, and is answered by one line:

   list                               the kernels that are there
   names HOST/KERNEL                  the components of one
   set HOST/KERNEL COMPONENT PARAM N  changes a parameter
   read HOST/KERNEL PORT              has an out-port written to `inp`
   write HOST/KERNEL PORT N...        writes numbers to an in-port
   received                           what has come to `inp` since */

#define _GNU_SOURCE
#include <inttypes.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>
#include <zenoh-pico.h>

#include "foreign_frames.h"

#if Z_FRAG_MAX_SIZE < 1100000
#error "messages of 1,050,000 bytes have to fit: build zenoh-pico with -DFRAG_MAX_SIZE=1100000"
#endif

#define DOMAIN "aiorts/1/default"
#define LONG 600
#define ANY 16
#define WINDOW 256
#define UNDER_WAY 65536
#define TOLD 65536

static int64_t now_ns(clockid_t clock) {
    struct timespec now;
    clock_gettime(clock, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static int64_t now_ms(void) { return now_ns(CLOCK_MONOTONIC) / 1000000; }

/* -- msgpack -------------------------------------------------------------------------------------------------------- */

typedef struct {
    uint8_t bytes[8192];
    size_t size;
} pack_t;

static void put_byte(pack_t *pack, unsigned byte) { pack->bytes[pack->size++] = (uint8_t)byte; }

static void put_big(pack_t *pack, uint64_t value, int size) {
    while (size--) put_byte(pack, (unsigned)(value >> (8 * size)) & 255);
}

static void put_raw(pack_t *pack, const void *bytes, size_t size) {
    memcpy(pack->bytes + pack->size, bytes, size);
    pack->size += size;
}

static void put_list(pack_t *pack, unsigned count) { put_byte(pack, 0x90 | count); }
static void put_map(pack_t *pack, unsigned count) { put_byte(pack, 0x80 | count); }

static void put_text(pack_t *pack, const char *text) {
    size_t size = strlen(text);
    put_byte(pack, 0xda);
    put_big(pack, size, 2);
    put_raw(pack, text, size);
}

static void put_bytes(pack_t *pack, const void *bytes, size_t size) {
    put_byte(pack, 0xc5);
    put_big(pack, size, 2);
    put_raw(pack, bytes, size);
}

static void put_unsigned(pack_t *pack, uint64_t value) {
    put_byte(pack, 0xcf);
    put_big(pack, value, 8);
}

static void put_pair(pack_t *pack, const char *key, const char *text) {
    put_text(pack, key);
    put_text(pack, text);
}

typedef struct {
    const uint8_t *at, *end;
} cursor_t;

typedef struct {
    char kind; /* n: nothing, b: bool, i: integer, f: float, s: text, x: bytes, a: list, m: map, 0: none */
    int64_t number;
    const uint8_t *text;
    uint32_t size;
} value_t;

static uint64_t take_big(cursor_t *from, int size) {
    uint64_t value = 0;
    if (from->end - from->at < size) {
        from->at = from->end;
        return 0;
    }
    while (size--) value = value << 8 | *from->at++;
    return value;
}

static value_t sized(cursor_t *from, char kind, uint64_t size) {
    value_t found = {kind, 0, from->at, (uint32_t)size};
    if (kind == 's' || kind == 'x') {
        if ((uint64_t)(from->end - from->at) < size) return (value_t){0};
        from->at += size;
    }
    return found;
}

/* The next value; of a list or map its size, its items come next. */
static value_t take(cursor_t *from) {
    if (from->at >= from->end) return (value_t){0};
    unsigned first = *from->at++;
    if (first < 0x80) return (value_t){'i', first, NULL, 0};
    if (first >= 0xe0) return (value_t){'i', (int8_t)first, NULL, 0};
    if (first < 0x90) return sized(from, 'm', first & 15);
    if (first < 0xa0) return sized(from, 'a', first & 15);
    if (first < 0xc0) return sized(from, 's', first & 31);
    switch (first) {
        case 0xc0: return (value_t){'n', 0, NULL, 0};
        case 0xc2: case 0xc3: return (value_t){'b', first & 1, NULL, 0};
        case 0xc4: case 0xc5: case 0xc6: return sized(from, 'x', take_big(from, 1 << (first - 0xc4)));
        case 0xca: take_big(from, 4); return (value_t){'f', 0, NULL, 0};
        case 0xcb: take_big(from, 8); return (value_t){'f', 0, NULL, 0};
        case 0xcc: case 0xcd: case 0xce: case 0xcf:
            return (value_t){'i', (int64_t)take_big(from, 1 << (first - 0xcc)), NULL, 0};
        case 0xd0: return (value_t){'i', (int8_t)take_big(from, 1), NULL, 0};
        case 0xd1: return (value_t){'i', (int16_t)take_big(from, 2), NULL, 0};
        case 0xd2: return (value_t){'i', (int32_t)take_big(from, 4), NULL, 0};
        case 0xd3: return (value_t){'i', (int64_t)take_big(from, 8), NULL, 0};
        case 0xd9: case 0xda: case 0xdb: return sized(from, 's', take_big(from, 1 << (first - 0xd9)));
        case 0xdc: case 0xdd: return sized(from, 'a', take_big(from, first == 0xdc ? 2 : 4));
        case 0xde: case 0xdf: return sized(from, 'm', take_big(from, first == 0xde ? 2 : 4));
        default: return (value_t){0};
    }
}

static void skip(cursor_t *from) {
    value_t value = take(from);
    uint64_t items = value.kind == 'a' ? value.size : value.kind == 'm' ? 2ULL * value.size : 0;
    while (items-- && from->at < from->end) skip(from);
}

static int is(value_t value, const char *text) {
    return value.kind == 's' && value.size == strlen(text) && !memcmp(value.text, text, value.size);
}

/* The value of a key of the map that begins here; kind 0: there is none. `inside` is set behind its header. */
static value_t of_key(cursor_t from, const char *key, cursor_t *inside) {
    value_t map = take(&from);
    for (uint32_t place = 0; map.kind == 'm' && place < map.size; place++) {
        int meant = is(take(&from), key);
        cursor_t at = from;
        if (meant) {
            value_t found = take(&from);
            if (inside) *inside = found.kind == 'a' || found.kind == 'm' ? at : from;
            return found;
        }
        skip(&from);
    }
    return (value_t){0};
}

static void copy_text(char *to, value_t value) {
    size_t size = value.size < LONG - 1 ? value.size : LONG - 1;
    memcpy(to, value.text, size);
    to[size] = 0;
}

/* -- the engine ----------------------------------------------------------------------------------------------------- */

enum { ARRIVED, SAID, PRESENT, CLIENT, ASKED, CALLED, REPLIED, TYPED };

typedef struct event {
    struct event *next;
    int what, up;
    char key[LONG];
    uint8_t *body, *beside;
    size_t size, beside_size;
    z_owned_query_t query;
    struct asking *asking;
} event_t;

static z_owned_session_t session;
static event_t *first_event, **last_event = &first_event;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t news = PTHREAD_COND_INITIALIZER;

static void hand_over(event_t *event) {
    pthread_mutex_lock(&lock);
    *last_event = event;
    last_event = &event->next;
    pthread_cond_signal(&news);
    pthread_mutex_unlock(&lock);
}

static uint8_t *copied(const z_loaned_bytes_t *bytes, size_t *size) {
    z_owned_slice_t slice;
    if (!bytes || z_bytes_to_slice(bytes, &slice) < 0) {
        *size = 0;
        return NULL;
    }
    *size = z_slice_len(z_loan(slice));
    uint8_t *found = malloc(*size + 1);
    memcpy(found, z_slice_data(z_loan(slice)), *size);
    z_drop(z_move(slice));
    return found;
}

static event_t *new_event(int what, const z_loaned_keyexpr_t *key) {
    event_t *event = calloc(1, sizeof *event);
    event->what = what;
    if (key) {
        z_view_string_t text;
        z_keyexpr_as_view_string(key, &text);
        snprintf(event->key, LONG, "%.*s", (int)z_string_len(z_loan(text)), z_string_data(z_loan(text)));
    }
    return event;
}

static void came(z_loaned_sample_t *sample, void *what) {
    event_t *event = new_event((int)(intptr_t)what, z_sample_keyexpr(sample));
    event->up = z_sample_kind(sample) == Z_SAMPLE_KIND_PUT;
    event->body = copied(z_sample_payload(sample), &event->size);
    hand_over(event);
}

static void queried(z_loaned_query_t *query, void *what) {
    event_t *event = new_event((int)(intptr_t)what, z_query_keyexpr(query));
    event->body = copied(z_query_payload(query), &event->size);
    event->beside = copied(z_query_attachment(query), &event->beside_size);
    z_query_clone(&event->query, query);
    hand_over(event);
}

static char *text_of(const char *form, ...) {
    static char texts[8][LONG];
    static int last;
    char *text = texts[last++ % 8];
    va_list words;
    va_start(words, form);
    vsnprintf(text, LONG, form, words);
    va_end(words);
    return text;
}

static void subscribe(const char *key, int what) {
    z_view_keyexpr_t ke;
    z_view_keyexpr_from_str(&ke, key);
    z_owned_closure_sample_t closure;
    z_closure_sample(&closure, came, NULL, (void *)(intptr_t)what);
    if (z_declare_background_subscriber(z_loan(session), z_loan(ke), z_move(closure), NULL) < 0) exit(3);
}

static void watch(const char *key, int what) {
    z_view_keyexpr_t ke;
    z_view_keyexpr_from_str(&ke, key);
    z_owned_closure_sample_t closure;
    z_closure_sample(&closure, came, NULL, (void *)(intptr_t)what);
    z_liveliness_subscriber_options_t options;
    z_liveliness_subscriber_options_default(&options);
    options.history = true;
    if (z_liveliness_declare_background_subscriber(z_loan(session), z_loan(ke), z_move(closure), &options) < 0) exit(3);
}

static void answer_at(const char *key, int what) {
    z_view_keyexpr_t ke;
    z_view_keyexpr_from_str(&ke, key);
    z_owned_closure_query_t closure;
    z_closure_query(&closure, queried, NULL, (void *)(intptr_t)what);
    z_queryable_options_t options;
    z_queryable_options_default(&options);
    options.complete = true;
    if (z_declare_background_queryable(z_loan(session), z_loan(ke), z_move(closure), &options) < 0) exit(3);
}

static void put(const char *key, const uint8_t *bytes, size_t size, int urgent) {
    z_view_keyexpr_t ke;
    z_view_keyexpr_from_str(&ke, key);
    z_owned_bytes_t payload;
    z_bytes_copy_from_buf(&payload, bytes, size);
    z_put_options_t options;
    z_put_options_default(&options);
    options.priority = urgent ? Z_PRIORITY_INTERACTIVE_HIGH : Z_PRIORITY_DATA;
    options.is_express = true;
    z_put(z_loan(session), z_loan(ke), z_move(payload), &options);
}

static void put_envelope(const char *key, unsigned kind, uint32_t epoch, uint64_t first, const void *bytes, size_t size) {
    uint8_t made[16384];
    message_t message = {.kind = kind, .epoch = epoch, .first = first, .count = size > 0};
    message.sent_ns = now_ns(CLOCK_REALTIME);
    message.blocks[0] = (block_t){bytes, (uint32_t)size};
    put(key, made, put_message(made, &message), 1);
}

static void reply(event_t *event, const char *key, const pack_t *pack, int good) {
    z_view_keyexpr_t ke;
    z_view_keyexpr_from_str(&ke, key);
    z_owned_bytes_t payload;
    z_bytes_copy_from_buf(&payload, pack->bytes, pack->size);
    if (good)
        z_query_reply(z_loan(event->query), z_loan(ke), z_move(payload), NULL);
    else
        z_query_reply_err(z_loan(event->query), z_move(payload), NULL);
}

/* -- this kernel ---------------------------------------------------------------------------------------------------- */

typedef struct {
    char pair[LONG];
    uint64_t epoch;
} peer_t;

typedef struct {
    int is_writer, is_open, greeted;
    char name[LONG], writer[LONG], reader[LONG], pair[LONG], at[LONG], of[LONG];
    uint64_t epoch, far_epoch;
    uint32_t number, channel_epoch;
    uint64_t sent_cost, taken_cost, came_cost, told_cost;
    uint64_t next, oldest, sent, received;
    int64_t again_ms;
    uint8_t kept[WINDOW][12];
} link_t;

typedef struct {
    int used;
    char base[LONG];
    uint32_t number;
    uint64_t sent, used_up, came;
    uint8_t kept[131072], in[131072];
    size_t in_size;
} session_t;

typedef struct asking {
    char key[LONG];
    pack_t body;
    uint8_t beside[LONG];
    size_t beside_size;
    int what, replied;
    link_t *link;
} asking_t;

static const char *host, *kernel;
static char own[LONG], hash[64], layout[4096];
static uint64_t epoch, questions;
static uint32_t numbers = 100;
static peer_t peers[ANY];
static link_t links[ANY];
static session_t sessions[ANY];
static int active;
static int64_t step = 1, count;
static long values[100000];
static int values_count;

static uint64_t random_number(void) {
    uint64_t found = 0;
    FILE *file = fopen("/dev/urandom", "rb");
    if (!file || fread(&found, sizeof found, 1, file) != 1) exit(3);
    fclose(file);
    return found;
}

static peer_t *peer_of(const char *pair) {
    for (int place = 0; place < ANY; place++)
        if (peers[place].epoch && !strcmp(peers[place].pair, pair)) return &peers[place];
    return NULL;
}

static link_t *new_link(int is_writer, const char *pair, const char *name) {
    for (int place = 0; place < ANY; place++) {
        link_t *one = &links[place];
        if (one->epoch && one->is_writer == is_writer && !strcmp(one->name, name) && !strcmp(one->pair, pair)) return one;
        if (one->epoch) continue;
        one->is_writer = is_writer;
        strcpy(one->pair, pair);
        strcpy(one->name, name);
        one->epoch = random_number();
        one->next = one->oldest = 1;
        return one;
    }
    exit(4);
}

static int send_frame(link_t *link, const uint8_t *frame, size_t size) {
    if (link->sent_cost - link->taken_cost >= UNDER_WAY) {
        put_envelope(link->at, LOOK, link->channel_epoch, link->sent_cost, NULL, 0);
        return 0;
    }
    put_envelope(link->at, FRAME, link->channel_epoch, link->sent_cost, frame, size);
    link->sent_cost += cost_of(HEAD + 4 + size);
    return 1;
}

static void send_head(link_t *link, unsigned kind, uint64_t one, uint64_t two) {
    uint8_t made[HEAD];
    head_t head = {kind, 0, 0, link->number, one, two};
    send_frame(link, made, put_head(made, &head));
}

static void open_link(link_t *link, uint32_t number, uint64_t far_epoch) {
    uint64_t writer_epoch = link->is_writer ? link->epoch : far_epoch;
    const char *mine = text_of("%s/%s", host, kernel);
    const char *ends = link->is_writer ? text_of("%s/%s", mine, link->pair) : text_of("%s/%s", link->pair, mine);
    snprintf(link->at, LONG, DOMAIN "/link/%.300s/%u/%c", ends, number, link->is_writer ? 'w' : 'r');
    snprintf(link->of, LONG, DOMAIN "/link/%.300s/%u/%c", ends, number, link->is_writer ? 'r' : 'w');
    if (far_epoch != link->far_epoch) {
        link->received = 0;
        if (link->is_writer && link->far_epoch) link->oldest = link->next = 1, link->sent = 0;
    }
    link->number = number;
    link->far_epoch = far_epoch;
    link->channel_epoch = (uint32_t)writer_epoch;
    link->sent_cost = link->taken_cost = link->came_cost = link->told_cost = 0;
    link->is_open = 1;
    link->greeted = 0;
    link->again_ms = 0;
    if (!link->is_writer) send_head(link, HELLO, link->epoch, link->received);
}

static void write_to(link_t *link, int32_t value) {
    if (link->next - link->oldest >= WINDOW) return;
    uint8_t *kept = link->kept[link->next++ % WINDOW];
    put_number(kept, (uint64_t)now_ns(CLOCK_REALTIME), 8);
    put_number(kept + 8, (uint32_t)value, 4);
}

static void poll_link(link_t *link) {
    int64_t now = now_ms();
    if (!link->is_open || !link->is_writer) return;
    if (!link->greeted) {
        if (now >= link->again_ms) {
            send_head(link, HELLO, link->epoch, 0);
            link->again_ms = now + 200;
        }
        return;
    }
    if (link->sent >= link->oldest && now >= link->again_ms) {
        link->sent = link->oldest - 1;
        link->again_ms = now + 500;
    }
    while (link->sent + 1 < link->next) {
        uint8_t made[HEAD + 12];
        head_t head = {DATA, 0, 1, link->number, link->sent + 1, link->oldest};
        size_t size = put_head(made, &head);
        memcpy(made + size, link->kept[(link->sent + 1) % WINDOW], 12);
        if (!send_frame(link, made, size + 12)) return;
        link->sent++;
        if (link->again_ms < now + 200) link->again_ms = now + 200;
    }
}

static void frame_of_reader(link_t *link, const head_t *head) {
    if (head->kind == HELLO && head->one == link->far_epoch && !link->greeted) {
        link->greeted = 1;
        link->sent = head->two > link->oldest - 1 ? head->two : link->oldest - 1;
    } else if (head->kind == ACK && head->one <= head->two && head->two < link->next) {
        if (head->one + 1 > link->oldest) link->oldest = head->one + 1;
        if (head->two > link->sent) link->sent = head->two;
        link->again_ms = now_ms() + 200;
    } else if (head->kind == BYE)
        link->is_open = 0;
}

static void frame_of_writer(link_t *link, const head_t *head, const uint8_t *rest, size_t size) {
    if (head->kind == HELLO && head->one == link->far_epoch) {
        send_head(link, HELLO, link->epoch, link->received);
        send_head(link, ACK, link->received, link->received);
    } else if (head->kind == DATA && size >= (head->flags & 2 ? 8 * head->count : 0)) {
        if (head->flags & 2) rest += 8 * head->count;
        if (head->count > 1) rest += 4 * head->count; /* TimedLong: each has 12 bytes */
        for (unsigned place = 0; place < head->count; place++, rest += 12) {
            if (head->one + place != link->received + 1) continue;
            link->received++;
            if (values_count < 100000) values[values_count++] = (int32_t)number_at(rest + 8, 4);
        }
        send_head(link, ACK, link->received, link->received);
    } else if (head->kind == BYE)
        link->is_open = 0;
}

static void frame_came(event_t *event) {
    message_t message;
    head_t head;
    for (int place = 0; place < ANY; place++) {
        link_t *link = &links[place];
        if (!link->is_open || strcmp(link->of, event->key) || !find_message(event->body, event->size, &message)) continue;
        if (message.epoch != link->channel_epoch) continue;
        if (message.kind == TAKEN) {
            if (message.first > link->taken_cost && message.first <= link->sent_cost) link->taken_cost = message.first;
            continue;
        }
        uint64_t taken = message.first + (message.kind <= PIECE ? cost_of(event->size) : 0);
        if (taken > link->came_cost) link->came_cost = taken;
        if (message.kind == LOOK || link->came_cost - link->told_cost >= TOLD) {
            link->told_cost = link->came_cost;
            put_envelope(link->at, TAKEN, link->channel_epoch, link->told_cost, NULL, 0);
        }
        if (message.kind != FRAME || !message.count) continue;
        size_t size = find_head(message.blocks[0].bytes, message.blocks[0].size, &head);
        if (!size || head.link != link->number) continue;
        if (link->is_writer)
            frame_of_reader(link, &head);
        else
            frame_of_writer(link, &head, message.blocks[0].bytes + size, message.blocks[0].size - size);
    }
}

/* -- questions ------------------------------------------------------------------------------------------------------ */

enum { OFFER, REQUEST, CALL };

static void answered(z_loaned_reply_t *one, void *context) {
    event_t *event = new_event(REPLIED, NULL);
    event->asking = context;
    event->up = z_reply_is_ok(one) ? 1 : 0;
    event->body = event->up ? copied(z_sample_payload(z_reply_ok(one)), &event->size)
                            : copied(z_reply_err_payload(z_reply_err(one)), &event->size);
    hand_over(event);
}

static void nothing_more(void *context) {
    event_t *event = new_event(REPLIED, NULL);
    event->asking = context;
    event->up = -1;
    hand_over(event);
}

static void ask(asking_t *asking) {
    z_view_keyexpr_t ke;
    z_view_keyexpr_from_str(&ke, asking->key);
    z_owned_closure_reply_t closure;
    z_closure_reply(&closure, answered, nothing_more, asking);
    z_get_options_t options;
    z_get_options_default(&options);
    z_owned_bytes_t body, beside;
    z_bytes_copy_from_buf(&body, asking->body.bytes, asking->body.size);
    options.payload = z_move(body);
    if (asking->beside_size) {
        z_bytes_copy_from_buf(&beside, asking->beside, asking->beside_size);
        options.attachment = z_move(beside);
    }
    options.timeout_ms = 5000;
    if (z_get(z_loan(session), z_loan(ke), "", z_move(closure), &options) < 0) exit(5);
}

static asking_t *new_question(const char *pair, const char *what) {
    asking_t *asking = calloc(1, sizeof *asking);
    peer_t *peer = peer_of(pair);
    snprintf(asking->key, LONG, DOMAIN "/svc/%s/%016" PRIx64 "/%s/%s", pair, peer ? peer->epoch : 0, kernel, what);
    put_number(asking->beside, epoch, 8);
    put_number(asking->beside + 8, ++questions, 8);
    asking->beside_size = 16 + (size_t)sprintf((char *)asking->beside + 16, "%s/%s", host, kernel);
    return asking;
}

static void put_versions(pack_t *pack) {
    put_list(pack, 2);
    put_byte(pack, 1);
    put_byte(pack, 1);
}

static void offer(link_t *link) {
    if (!peer_of(link->pair)) return;
    asking_t *asking = new_question(link->pair, "offer");
    pack_t *pack = &asking->body;
    uint8_t bytes[16];
    for (int place = 0; place < 16; place++) sscanf(hash + 2 * place, "%2hhx", bytes + place);
    put_list(pack, 5);
    put_versions(pack);
    put_text(pack, link->name);
    put_list(pack, 5);
    put_text(pack, link->writer);
    put_text(pack, link->reader);
    put_unsigned(pack, link->epoch);
    put_byte(pack, 0);
    put_byte(pack, 0);
    put_list(pack, 4);
    put_bytes(pack, bytes, 16);
    put_text(pack, layout);
    put_text(pack, "");
    put_list(pack, 0);
    put_list(pack, 4);
    put_text(pack, link->name);
    put_map(pack, 3);
    put_pair(pack, "subscription", "new");
    put_pair(pack, "push", "all");
    put_pair(pack, "on_link_lost", "wait");
    put_unsigned(pack, WINDOW);
    put_unsigned(pack, 8 << 20);
    asking->what = OFFER;
    asking->link = link;
    ask(asking);
}

static link_t *writes(const char *pair, const char *name, const char *out, const char *in) {
    link_t *link = new_link(1, pair, name);
    strcpy(link->writer, out);
    strcpy(link->reader, in);
    return link;
}

static void put_answer(pack_t *pack, uint32_t number, uint64_t of, const char *refused) {
    put_list(pack, 5);
    put_unsigned(pack, number);
    put_unsigned(pack, of);
    put_text(pack, "");
    put_text(pack, refused);
    put_versions(pack);
}

static int ends_with(const char *text, const char *end) {
    size_t size = strlen(text), least = strlen(end);
    return size >= least && !strcmp(text + size - least, end);
}

static void was_asked(event_t *event) {
    pack_t answer = {.size = 0};
    char name[LONG] = "", what[LONG] = "", pair[LONG] = "", writer[LONG], reader[LONG];
    const char *last = strrchr(event->key, '/'), *before = last;
    while (*--before != '/') {}
    snprintf(name, LONG, "%.*s", (int)(last - before - 1), before + 1);
    snprintf(what, LONG, "%s", last + 1);
    if (event->beside_size > 16)
        snprintf(pair, LONG, "%.*s", (int)(event->beside_size - 16), (char *)event->beside + 16);
    peer_t *peer = peer_of(pair);
    cursor_t body = {event->body, event->body + event->size};
    link_t *opened = NULL;
    uint64_t writer_epoch = 0;
    int good = 1;
    if (!peer || peer->epoch != number_at(event->beside, 8) || !ends_with(pair, text_of("/%s", name))) {
        good = 0;
        put_raw(&answer, "who asks is not known here", 26);
    } else if (!strcmp(what, "clock")) {
        put_number(answer.bytes, (uint64_t)now_ns(CLOCK_REALTIME), 8);
        answer.size = 8;
    } else if (!strcmp(what, "come")) {
        for (int place = 0; place < ANY; place++)
            if (links[place].epoch && links[place].is_writer && !strcmp(links[place].pair, pair)) offer(&links[place]);
    } else if (!strcmp(what, "offer")) {
        char link_name[LONG];
        take(&body), skip(&body);
        copy_text(link_name, take(&body));
        take(&body), skip(&body);
        copy_text(reader, take(&body));
        writer_epoch = (uint64_t)take(&body).number;
        skip(&body), skip(&body), take(&body);
        value_t theirs = take(&body);
        char shown[64] = "";
        for (uint32_t place = 0; place < theirs.size && place < 16; place++) sprintf(shown + 2 * place, "%02x", theirs.text[place]);
        if (!ends_with(reader, "/twin.inp"))
            put_answer(&answer, 0, 0, "is no in-port");
        else if (strcmp(shown, hash))
            put_answer(&answer, 0, 0, "types differ");
        else {
            opened = new_link(0, pair, link_name);
            put_answer(&answer, ++numbers, opened->epoch, "");
        }
    } else if (!strcmp(what, "request")) {
        take(&body), skip(&body);
        copy_text(writer, take(&body));
        copy_text(reader, take(&body));
        if (ends_with(writer, "/twin.out")) {
            put_answer(&answer, 0, 0, "");
            offer(writes(pair, text_of("%.200s to %.200s", writer, reader), writer, reader));
        } else
            put_answer(&answer, 0, 0, "is no out-port");
    } else {
        good = 0;
        put_raw(&answer, "does not know the question", 26);
    }
    reply(event, event->key, &answer, good);
    if (opened) open_link(opened, numbers, writer_epoch);
}

/* -- clients of this kernel ----------------------------------------------------------------------------------------- */

static void put_error(pack_t *pack, const char *code, const char *text) {
    put_text(pack, "error");
    put_map(pack, 2);
    put_pair(pack, "code", code);
    put_pair(pack, "text", text);
}

static void put_hello(pack_t *pack, int operates, unsigned more) {
    put_map(pack, 5 + more);
    put_pair(pack, "address", text_of("%s/%s", host, kernel));
    put_pair(pack, "epoch", text_of("%016" PRIx64, epoch));
    put_pair(pack, "kernel", kernel);
    put_text(pack, "pid");
    put_unsigned(pack, (uint64_t)getpid());
    put_pair(pack, "right", operates ? "operate" : "view");
}

/* "ok" and the value of an operation, or "error". */
static void operate(pack_t *pack, const char *what, int operates, cursor_t given) {
    cursor_t inside;
    value_t component = of_key(given, "component", NULL);
    if (!strcmp(what, "hello")) {
        put_text(pack, "ok");
        put_hello(pack, operates, 0);
    } else if (!strcmp(what, "names")) {
        put_text(pack, "ok");
        put_map(pack, 7);
        put_pair(pack, "address", text_of("%s/%s", host, kernel));
        put_pair(pack, "state", "open");
        put_text(pack, "components"), put_map(pack, 1), put_text(pack, "twin"), put_map(pack, 1);
        put_pair(pack, "main", active ? "active" : "inactive");
        put_text(pack, "contexts"), put_map(pack, 1), put_text(pack, "main"), put_list(pack, 1), put_text(pack, "twin");
        put_text(pack, "connectors"), put_map(pack, 0);
        put_text(pack, "in_error"), put_list(pack, 0);
        put_pair(pack, "links", kernel);
    } else if (!is(component, "twin"))
        put_error(pack, "E-ABSENT", "no such component");
    else if (!strcmp(what, "configuration")) {
        put_text(pack, "ok");
        put_map(pack, 3);
        put_pair(pack, "active", "default");
        put_text(pack, "sets"), put_map(pack, 1), put_text(pack, "default"), put_map(pack, 1);
        put_text(pack, "step"), put_unsigned(pack, (uint64_t)step);
        put_text(pack, "parameters"), put_list(pack, 1), put_map(pack, 7);
        put_pair(pack, "name", "step");
        put_pair(pack, "type", "int");
        put_text(pack, "value"), put_unsigned(pack, (uint64_t)step);
        put_text(pack, "default"), put_unsigned(pack, 1);
        put_pair(pack, "unit", ""), put_pair(pack, "doc", ""), put_pair(pack, "constraint", "");
    } else if (strcmp(what, "configure") && strcmp(what, "activate") && strcmp(what, "deactivate"))
        put_error(pack, "E-CONTROL", "no such operation");
    else if (!operates)
        put_error(pack, "E-DENIED", "needs the right 'operate'");
    else {
        if (strcmp(what, "configure"))
            active = !strcmp(what, "activate");
        else if (of_key(given, "values", &inside).kind == 'm' && of_key(inside, "", &inside).kind == 'm') {
            value_t value = of_key(inside, "step", NULL);
            step = value.kind == 's' ? atoll(text_of("%.*s", (int)value.size, (const char *)value.text)) : value.number;
        }
        put_text(pack, "ok"), put_map(pack, 1), put_pair(pack, "text", "");
    }
}

static int is_operated(const char *key) { return strstr(key, DOMAIN "/ctl/") == key; }

static void was_called(event_t *event) {
    pack_t answer = {.size = 0};
    const char *last = strrchr(event->key, '/'), *caller = last;
    while (*--caller != '/') {}
    put_map(&answer, 1);
    operate(&answer, last + 1, is_operated(event->key), (cursor_t){event->body, event->body + event->size});
    reply(event, text_of(DOMAIN "/%s/%s%s", is_operated(event->key) ? "ctl" : "info", own, caller), &answer, 1);
}

static void say(session_t *one, const pack_t *pack) {
    pack_t frame = {.size = 0};
    put_big(&frame, pack->size, 4);
    put_raw(&frame, pack->bytes, pack->size);
    if (one->sent + frame.size > sizeof one->kept) exit(6); /* longer than commands of a test need */
    memcpy(one->kept + one->sent, frame.bytes, frame.size);
    put_envelope(text_of("%s/s", one->base), FRAME, one->number, one->sent, frame.bytes, frame.size);
    one->sent += frame.size;
}

static void was_told(session_t *one, cursor_t said) {
    pack_t answer = {.size = 0};
    cursor_t args = {NULL, NULL};
    char operation[LONG];
    int operates = is_operated(one->base);
    if (of_key(said, "hello", NULL).kind == 'm') {
        put_map(&answer, 1);
        put_text(&answer, "hello");
        put_hello(&answer, operates, 1);
        put_text(&answer, "protocol"), put_byte(&answer, 1);
        say(one, &answer);
    } else if (of_key(said, "op", NULL).kind == 's') {
        copy_text(operation, of_key(said, "op", NULL));
        of_key(said, "args", &args);
        put_map(&answer, 2);
        put_text(&answer, "id"), put_unsigned(&answer, (uint64_t)of_key(said, "id", NULL).number);
        operate(&answer, operation, operates, args);
        say(one, &answer);
    }
}

static void session_came(event_t *event) {
    message_t message;
    char base[LONG];
    snprintf(base, LONG, "%.*s", (int)strlen(event->key) - 2, event->key);
    if (!find_message(event->body, event->size, &message)) return;
    session_t *one = NULL;
    for (int place = 0; place < ANY; place++)
        if (sessions[place].used && !strcmp(sessions[place].base, base)) one = &sessions[place];
    for (int place = 0; place < ANY && !one && message.kind == FRAME && !message.first; place++)
        if (!sessions[place].used) {
            one = &sessions[place];
            memset(one, 0, sizeof *one);
            one->used = 1;
            one->number = message.epoch;
            strcpy(one->base, base);
        }
    if (!one || message.epoch != one->number) return;
    const char *at = text_of("%s/s", base);
    if (message.kind == TAKEN) {
        if (message.first > one->used_up) one->used_up = message.first;
    } else if (message.kind == HAVE) {
        if (message.first < one->sent)
            put_envelope(at, FRAME, one->number, message.first, one->kept + message.first, one->sent - message.first);
    } else if (message.kind == LOOK) {
        put_envelope(at, TAKEN, one->number, one->came, NULL, 0);
        if (one->came < message.first) put_envelope(at, HAVE, one->number, one->came, NULL, 0);
    } else if (message.first == one->came) {
        uint32_t size = message.kind == FRAME && message.count ? message.blocks[0].size : 0;
        one->came += message.kind == END ? 1 : size;
        if (one->in_size + size > sizeof one->in) return;
        if (size) memcpy(one->in + one->in_size, message.blocks[0].bytes, size);
        one->in_size += size;
        put_envelope(at, TAKEN, one->number, one->came, NULL, 0);
        cursor_t in = {one->in, one->in + one->in_size};
        while (in.end - in.at >= 4) {
            cursor_t frame = in;
            uint64_t length = take_big(&frame, 4);
            if ((uint64_t)(frame.end - frame.at) < length) break;
            was_told(one, (cursor_t){frame.at, frame.at + length});
            in.at = frame.at + length;
        }
        one->in_size = (size_t)(in.end - in.at);
        memmove(one->in, in.at, one->in_size);
    }
}

static void client_present(event_t *event) {
    for (int place = 0; place < ANY; place++)
        if (!event->up && strlen(event->key) > 5 && !strncmp(sessions[place].base, event->key, strlen(event->key) - 5))
            sessions[place].used = 0;
}

/* -- others --------------------------------------------------------------------------------------------------------- */

static void kernel_present(event_t *event) {
    char at_host[LONG], name[LONG], start[LONG];
    uint64_t of;
    if (sscanf(event->key, DOMAIN "/live/%599[^/]/%599[^/]/%599[^/]", at_host, name, start) != 3) return;
    if (sscanf(strchr(start, '-') + 1, "%16" SCNx64, &of) != 1 || of == epoch) return;
    char pair[LONG];
    snprintf(pair, LONG, "%.290s/%.290s", at_host, name);
    peer_t *peer = peer_of(pair);
    if (!event->up) {
        if (peer && peer->epoch == of && !ends_with(event->key, "/own")) {
            peer->epoch = 0;
            for (int place = 0; place < ANY; place++)
                if (!strcmp(links[place].pair, pair)) links[place].is_open = 0;
        }
        return;
    }
    if (peer && peer->epoch == of) return;
    for (int place = 0; place < ANY && !peer; place++)
        if (!peers[place].epoch) peer = &peers[place];
    if (!peer) return;
    strcpy(peer->pair, pair);
    peer->epoch = of;
    for (int place = 0; place < ANY; place++)
        if (links[place].epoch && links[place].is_writer && !strcmp(links[place].pair, pair)) offer(&links[place]);
}

static void show_answer(cursor_t answer) {
    cursor_t inside;
    value_t value = of_key(answer, "ok", &inside);
    if (!value.kind) {
        of_key(answer, "error", &inside);
        value = of_key(inside, "code", NULL);
        printf("\"%.*s\"\n", (int)value.size, (const char *)value.text);
        return;
    }
    value = of_key(inside, "components", &inside);
    printf("[");
    if (value.kind == 'm') take(&inside);
    for (uint32_t place = 0; value.kind == 'm' && place < value.size; place++) {
        value_t name = take(&inside);
        printf("%s\"%.*s\"", place ? ", " : "", (int)name.size, (const char *)name.text);
        skip(&inside);
    }
    printf("]\n");
}

static void replied(event_t *event) {
    asking_t *asking = event->asking;
    if (event->up < 0) {
        if (asking->replied)
            free(asking);
        else {
            usleep(50000);
            ask(asking);
        }
        return;
    }
    asking->replied = 1;
    cursor_t body = {event->body, event->body + event->size};
    if (asking->what == CALL) return show_answer(body);
    if (!event->up) {
        printf("\"%.*s\"\n", (int)event->size, (const char *)event->body);
        return;
    }
    take(&body);
    uint32_t number = (uint32_t)take(&body).number;
    uint64_t of = (uint64_t)take(&body).number;
    skip(&body);
    value_t refused = take(&body);
    if (asking->what == REQUEST)
        printf("\"%.*s\"\n", (int)refused.size, (const char *)refused.text);
    else if (number)
        open_link(asking->link, number, of);
}

static void call(const char *pair, const char *operation, const pack_t *given) {
    asking_t *asking = calloc(1, sizeof *asking);
    peer_t *peer = peer_of(pair);
    snprintf(asking->key, LONG, DOMAIN "/ctl/%s/%016" PRIx64 "/%s/%s", pair, peer ? peer->epoch : 0, kernel, operation);
    asking->body = *given;
    asking->what = CALL;
    ask(asking);
}

static void typed(char *line) {
    pack_t pack = {.size = 0};
    char *words[4096];
    int said = 0;
    for (char *word = strtok(line, " \n"); word && said < 4096; word = strtok(NULL, " \n")) words[said++] = word;
    if (!strcmp(words[0], "list")) {
        int found = 0;
        printf("[");
        for (int place = 0; place < ANY; place++)
            if (peers[place].epoch) printf("%s\"%s\"", found++ ? ", " : "", peers[place].pair);
        printf("]\n");
    } else if (!strcmp(words[0], "received")) {
        printf("[");
        for (int place = 0; place < values_count; place++) printf("%s%ld", place ? ", " : "", values[place]);
        printf("]\n");
        values_count = 0;
    } else if (!strcmp(words[0], "names")) {
        put_map(&pack, 0);
        call(words[1], "names", &pack);
    } else if (!strcmp(words[0], "set")) {
        put_map(&pack, 2);
        put_pair(&pack, "component", words[2]);
        put_text(&pack, "values"), put_map(&pack, 1), put_text(&pack, ""), put_map(&pack, 1);
        put_pair(&pack, words[3], words[4]);
        call(words[1], "configure", &pack);
    } else if (!strcmp(words[0], "read")) {
        asking_t *asking = new_question(words[1], "request");
        put_list(&asking->body, 4);
        put_versions(&asking->body);
        put_text(&asking->body, words[2]);
        put_text(&asking->body, text_of("%s/twin.inp", kernel));
        put_map(&asking->body, 2);
        put_pair(&asking->body, "subscription", "new");
        put_pair(&asking->body, "push", "all");
        asking->what = REQUEST;
        ask(asking);
    } else if (!strcmp(words[0], "write")) {
        link_t *link = writes(words[1], words[2], text_of("%s/twin.more", kernel), words[2]);
        if (!link->is_open) offer(link);
        for (int place = 3; place < said; place++) write_to(link, atoi(words[place]));
        printf("null\n");
    }
    fflush(stdout);
}

static void *read_lines(void *unused) {
    static char line[1 << 16];
    (void)unused;
    while (fgets(line, sizeof line, stdin)) {
        event_t *event = new_event(TYPED, NULL);
        event->body = (uint8_t *)strdup(line);
        hand_over(event);
    }
    _exit(0);
}

static void handle(event_t *event) {
    switch (event->what) {
        case ARRIVED: frame_came(event); break;
        case SAID: session_came(event); break;
        case PRESENT: kernel_present(event); break;
        case CLIENT: client_present(event); break;
        case ASKED: was_asked(event); break;
        case CALLED: was_called(event); break;
        case REPLIED: replied(event); break;
        default: typed((char *)event->body);
    }
    fflush(stdout);
    if (event->what == ASKED || event->what == CALLED) z_drop(z_move(event->query));
    free(event->body);
    free(event->beside);
    free(event);
}

static event_t *next_event(void) {
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_nsec += 5000000;
    if (until.tv_nsec >= 1000000000) until.tv_sec++, until.tv_nsec -= 1000000000;
    pthread_mutex_lock(&lock);
    if (!first_event) pthread_cond_timedwait(&news, &lock, &until);
    event_t *event = first_event;
    if (event && !(first_event = event->next)) last_event = &first_event;
    pthread_mutex_unlock(&lock);
    return event;
}

static void declare(z_owned_liveliness_token_t *token, const char *key) {
    z_view_keyexpr_t ke;
    z_view_keyexpr_from_str(&ke, key);
    if (z_liveliness_declare_token(z_loan(session), token, z_loan(ke), NULL) < 0) exit(3);
}

int main(int argc, char **argv) {
    if (argc != 6) return 2;
    host = argv[2], kernel = argv[3];
    snprintf(hash, sizeof hash, "%s", argv[4]);
    snprintf(layout, sizeof layout, "%s", argv[5]);
    epoch = random_number();
    snprintf(own, LONG, "%s/%s/%016" PRIx64, host, kernel, epoch);

    z_owned_config_t config;
    z_config_default(&config);
    zp_config_insert(z_loan_mut(config), Z_CONFIG_MODE_KEY, "client");
    zp_config_insert(z_loan_mut(config), Z_CONFIG_CONNECT_KEY, text_of("tcp/%s", argv[1]));
    if (z_open(&session, z_move(config), NULL) < 0) return 3;

    char pair[LONG];
    snprintf(pair, LONG, "%.290s/%.290s", host, kernel);
    subscribe(text_of(DOMAIN "/link/*/*/%s/*/w", pair), ARRIVED);
    subscribe(text_of(DOMAIN "/link/%s/*/*/*/r", pair), ARRIVED);
    answer_at(text_of(DOMAIN "/svc/%s/**", own), ASKED);
    for (int place = 0; place < 2; place++) {
        const char *branch = place ? "ctl" : "info";
        subscribe(text_of(DOMAIN "/%s/%s/*/*/c", branch, own), SAID);
        watch(text_of(DOMAIN "/%s/%s/*/*/live", branch, own), CLIENT);
        answer_at(text_of(DOMAIN "/%s/%s/*/*", branch, own), CALLED);
    }
    watch(DOMAIN "/live/*/*/**", PRESENT);
    char token[LONG];
    snprintf(token, LONG, DOMAIN "/live/%.300s/%" PRId64 "-%016" PRIx64 "-%016" PRIx64, pair, now_ns(CLOCK_REALTIME), epoch, random_number());
    z_owned_liveliness_token_t claims, owns;
    declare(&claims, token);
    int64_t owns_ms = now_ms() + 1000, tick_ms = 0;

    pthread_t reading;
    pthread_create(&reading, NULL, read_lines, NULL);
    printf("\"ready\"\n");
    fflush(stdout);
    for (;;) {
        event_t *event = next_event();
        if (event) handle(event);
        int64_t now = now_ms();
        if (owns_ms && now >= owns_ms) {
            owns_ms = 0;
            declare(&owns, text_of("%.590s/own", token));
        }
        if (active && now >= tick_ms) {
            tick_ms = now + 20;
            count += step;
            for (int place = 0; place < ANY; place++)
                if (links[place].is_writer && ends_with(links[place].writer, "twin.out")) write_to(&links[place], (int32_t)count);
        }
        for (int place = 0; place < ANY; place++) poll_link(&links[place]);
    }
}
