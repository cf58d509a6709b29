/* Does with foreign_frames.h what lines on standard input say: one line of answer for each.

   encode KIND EPOCH FIRST SENT [HEX]...   a message             decode HEX      its fields, or "none"
   head KIND FLAGS COUNT LINK ONE TWO      the head of a frame   fields HEX      its fields, or "none"
   cost SIZE                                                     join HEX:HEX... the frames that are whole

   An empty block is "-". */

#include <inttypes.h>
#include <stdio.h>

#include "foreign_frames.h"

static uint8_t *bytes_of(const char *hex, uint32_t *size) {
    *size = hex[0] == '-' ? 0 : (uint32_t)(strlen(hex) / 2);
    uint8_t *found = malloc(*size + 1);
    for (uint32_t place = 0; place < *size; place++) sscanf(hex + 2 * place, "%2hhx", found + place);
    return found;
}

static void show(const uint8_t *bytes, size_t size) {
    if (!size) putchar('-');
    for (size_t place = 0; place < size; place++) printf("%02x", bytes[place]);
}

static void show_blocks(const block_t *blocks, unsigned count) {
    for (unsigned place = 0; place < count; place++) {
        putchar(' ');
        show(blocks[place].bytes, blocks[place].size);
    }
}

int main(void) {
    static char line[1 << 20];
    static uint8_t made[1 << 20];
    while (fgets(line, sizeof line, stdin)) {
        char *words[64] = {0};
        int count = 0;
        for (char *word = strtok(line, " \n"); word && count < 64; word = strtok(NULL, " \n")) words[count++] = word;
        uint32_t size;
        if (!strcmp(words[0], "encode")) {
            message_t message = {.kind = (unsigned)atoi(words[1]), .epoch = (uint32_t)strtoull(words[2], NULL, 10)};
            message.first = strtoull(words[3], NULL, 10);
            message.sent_ns = strtoll(words[4], NULL, 10);
            for (int place = 5; place < count; place++) {
                block_t *block = &message.blocks[message.count++];
                block->bytes = bytes_of(words[place], &block->size);
            }
            show(made, put_message(made, &message));
        } else if (!strcmp(words[0], "decode")) {
            message_t message;
            uint8_t *bytes = bytes_of(words[1], &size);
            if (find_message(bytes, size, &message)) {
                printf("%u %" PRIu32 " %" PRIu64 " %" PRId64, message.kind, message.epoch, message.first, message.sent_ns);
                show_blocks(message.blocks, message.count);
            } else
                printf("none");
        } else if (!strcmp(words[0], "cost")) {
            printf("%" PRIu64, cost_of(strtoull(words[1], NULL, 10)));
        } else if (!strcmp(words[0], "head")) {
            head_t head = {.kind = (unsigned)atoi(words[1]), .flags = (unsigned)atoi(words[2])};
            head.count = (unsigned)atoi(words[3]);
            head.link = (uint32_t)strtoull(words[4], NULL, 10);
            head.one = strtoull(words[5], NULL, 10);
            head.two = strtoull(words[6], NULL, 10);
            show(made, put_head(made, &head));
        } else if (!strcmp(words[0], "fields")) {
            head_t head;
            uint8_t *bytes = bytes_of(words[1], &size);
            if (find_head(bytes, size, &head))
                printf("%u %u %u %" PRIu32 " %" PRIu64 " %" PRIu64, head.kind, head.flags, head.count, head.link,
                       head.one, head.two);
            else
                printf("none");
        } else if (!strcmp(words[0], "join")) {
            whole_t whole = {0};
            for (int place = 1; place < count; place++) {
                block_t piece[2], blocks[MOST];
                char *second = strchr(words[place], ':');
                *second++ = 0;
                piece[0].bytes = bytes_of(words[place], &piece[0].size);
                piece[1].bytes = bytes_of(second, &piece[1].size);
                unsigned found = add_piece(&whole, piece, blocks);
                if (found) {
                    printf("frame");
                    show_blocks(blocks, found);
                    putchar(' ');
                }
            }
        }
        putchar('\n');
    }
    return 0;
}
