/* Two million turns of random bytes, commands, times and levels, for sanitizers. */
#include "gatekeeper_core.h"

#include <stdio.h>

static uint64_t dice = 0x5EED;

static uint32_t throw_below(uint32_t below) {
    dice ^= dice << 13;
    dice ^= dice >> 7;
    dice ^= dice << 17;
    return (uint32_t)(dice % below);
}

static uint8_t line[GK_LINE];
static size_t length, at;

/* The next byte of a line with a right check sum, or now and then of anything. */
static void write_line(uint16_t number, uint16_t epoch, uint16_t config) {
    static const char digits[] = "0123456789ABCDEF";
    static const uint8_t lengths[14] = {0, 0, 2, 0, 0, 1, 3, 5, 20, 5, 0, 20, 0, 0};
    uint8_t bytes[GK_FRAME], command = (uint8_t)throw_below(16);
    size_t num_bytes = 0, payload = command < 14 ? lengths[command] : throw_below(GK_PAYLOAD + 1u);
    bytes[num_bytes++] = (uint8_t)(number >> 8);
    bytes[num_bytes++] = (uint8_t)number;
    bytes[num_bytes++] = command;
    bytes[num_bytes++] = (uint8_t)(epoch >> 8);
    bytes[num_bytes++] = (uint8_t)epoch;
    for (size_t i = 0; i < payload; i++) bytes[num_bytes++] = (uint8_t)(throw_below(3) ? throw_below(4) : throw_below(256));
    if (command == GK_ARM) {
        bytes[5] = (uint8_t)(config >> 8);
        bytes[6] = (uint8_t)config;
    }
    if (command == GK_BEGIN) {
        /* A sequence of one pattern that is zero; its check sum is that of a zero. */
        uint8_t zero = 0;
        uint16_t check = gk_crc(0xFFFFu, &zero, 1);
        bytes[5] = 0;
        bytes[6] = 1;
        bytes[7] = (uint8_t)(check >> 8);
        bytes[8] = (uint8_t)check;
        bytes[9] = (uint8_t)throw_below(2);
    }
    uint16_t check = gk_crc(0xFFFFu, bytes, num_bytes);
    bytes[num_bytes++] = (uint8_t)(check >> 8);
    bytes[num_bytes++] = (uint8_t)check;
    length = 0;
    at = 0;
    line[length++] = ':';
    for (size_t i = 0; i < num_bytes; i++) {
        line[length++] = (uint8_t)digits[bytes[i] >> 4];
        line[length++] = (uint8_t)digits[bytes[i] & 15u];
    }
    line[length++] = '\n';
    if (throw_below(10) == 0) line[throw_below((uint32_t)length)] = (uint8_t)throw_below(256);
}

int main(void) {
    static gk_core core;
    gk_board board = {42, 1, 8, 4, 1};
    gk_inputs in = {0, -1, 1, 0};
    gk_outputs out;
    unsigned long turns = 2000000, open = 0, wrong = 0;
    gk_power_up(&core, &board, 0xFFF00000u);
    in.now_us = 0xFFF00000u;
    for (unsigned long turn = 0; turn < turns; turn++) {
        if (at == length) {
            in.interlock_closed = throw_below(40) != 0;
            in.exposing = throw_below(2) != 0;
            in.now_us += throw_below(throw_below(200) == 0 ? 300000u : 400u);
            write_line(throw_below(30) == 0 ? (uint16_t)throw_below(65536) : (uint16_t)(core.number + 1u), core.board.epoch, core.config);
        }
        in.byte = line[at++];
        gk_step(&core, &in, &out);
        if (out.gates) open++;
        if (out.gates && !in.interlock_closed) wrong++;
        if (gk_idle_us(&core) > 1000000u) wrong++;
        if (throw_below(200000) == 0) {
            board.epoch++;
            gk_power_up(&core, &board, in.now_us);
        }
    }
    printf("%lu %lu %lu\n", turns, open, wrong);
    return 0;
}
