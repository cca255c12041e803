/* Frames on the line: what comes in is a whole, fresh command, or it is nothing. */

#include "gatekeeper_core.h"

#include <string.h>

uint16_t gk_crc(uint16_t crc, const uint8_t *bytes, size_t num_bytes) {
    for (size_t i = 0; i < num_bytes; i++) {
        crc = (uint16_t)(crc ^ ((uint16_t)bytes[i] << 8));
        for (uint8_t bit = 0; bit < 8; bit++) {
            uint16_t shifted = (uint16_t)(crc << 1);
            crc = (crc & 0x8000u) ? (uint16_t)(shifted ^ 0x1021u) : shifted;
        }
    }
    return crc;
}

static uint16_t word_at(const uint8_t *bytes) {
    return (uint16_t)(((uint16_t)bytes[0] << 8) | bytes[1]);
}

static void note_faulty(gk_core *core) {
    core->in_frame = 0;
    if (core->faulty < 0xFFFFu) core->faulty++;
}

/* Only capitals, so that every frame has one spelling. */
static int digit_of(uint8_t byte) {
    if (byte >= '0' && byte <= '9') return byte - '0';
    if (byte >= 'A' && byte <= 'F') return byte - 'A' + 10;
    return -1;
}

/* Whether the frame is this command for the first time, the command before once more, or out of place. */
static uint8_t answer_to_frame(gk_core *core, uint8_t num_bytes) {
    const uint8_t *frame = core->frame;
    const uint8_t *payload = frame + GK_HEADER;
    uint8_t length = (uint8_t)(num_bytes - GK_HEADER - 2u);
    uint16_t number = word_at(frame), epoch = word_at(frame + 3), check = word_at(frame + num_bytes - 2);
    uint8_t command = frame[2];

    core->answer_number = number;
    core->answer_command = command;
    if (command == GK_HELLO) {
        core->answer_status = length == 0 ? GK_OK : GK_LENGTH;
        if (length != 0) return 1;
        core->greeted = 1;
    } else if (epoch != core->board.epoch || !core->greeted
               || (number != (uint16_t)(core->number + 1u) && (number != core->number || check != core->check))) {
        core->answer_status = epoch != core->board.epoch ? GK_EPOCH : GK_NUMBER;
        /* Whoever closes is obeyed, however late or lost he is. */
        if (gk_closes(command, payload, length)) gk_execute(core, command, payload, length);
        return 1;
    } else if (number == core->number) {
        core->answer_status = core->status;
        return 1;
    } else {
        core->answer_status = gk_execute(core, command, payload, length);
    }
    core->number = number;
    core->check = check;
    core->status = core->answer_status;
    return 1;
}

static uint8_t end_of_frame(gk_core *core) {
    uint8_t num_bytes = core->num_digits / 2u;
    core->in_frame = 0;
    if (core->num_digits % 2u != 0 || num_bytes < GK_HEADER + 2u
        || gk_crc(0xFFFFu, core->frame, num_bytes - 2u) != word_at(core->frame + num_bytes - 2)) {
        note_faulty(core);
        return 0;
    }
    return answer_to_frame(core, num_bytes);
}

uint8_t gk_receive(gk_core *core, uint8_t byte) {
    if (byte == '!') {
        core->in_frame = 0;
        gk_close_for(core, GK_TRIP_COMMANDED);
        return 0;
    }
    if (byte == ':') {
        if (core->in_frame) note_faulty(core);
        core->in_frame = 1;
        core->num_digits = 0;
        return 0;
    }
    if (!core->in_frame) return 0;
    if (byte == '\n') return end_of_frame(core);
    int digit = digit_of(byte);
    if (digit < 0 || core->num_digits >= 2u * GK_FRAME) {
        note_faulty(core);
        return 0;
    }
    uint8_t *place = &core->frame[core->num_digits / 2u];
    *place = (uint8_t)(core->num_digits % 2u == 0 ? digit << 4 : *place | digit);
    core->num_digits++;
    return 0;
}

typedef struct {
    uint8_t bytes[GK_FRAME];
    uint8_t num_bytes;
} frame_out;

static void put(frame_out *frame, uint32_t value, uint8_t num_bytes) {
    while (num_bytes > 0) {
        num_bytes--;
        frame->bytes[frame->num_bytes++] = (uint8_t)(value >> (8u * num_bytes));
    }
}

static void put_identity(const gk_core *core, frame_out *frame) {
    put(frame, ((uint32_t)'G' << 8) | (uint32_t)'K', 2);
    put(frame, GK_PROTOCOL, 1);
    put(frame, GK_FIRMWARE, 1);
    put(frame, core->board.serial, 4);
    put(frame, core->board.gates, 1);
    put(frame, core->board.levels, 1);
    put(frame, GK_SEQUENCE, 2);
    put(frame, GK_WATCHDOG_US / 1000u, 2);
    put(frame, core->board.simulated ? 1u : 0u, 1);
    put(frame, core->config, 2);
}

static void put_state(const gk_core *core, frame_out *frame) {
    uint32_t flags = (core->armed ? 1u : 0u) | (core->interlock_closed ? 0u : 2u) | (core->exposing ? 4u : 0u)
        | (core->stepping != GK_STEP_NONE ? 8u : 0u) | (core->running ? 16u : 0u);
    put(frame, core->driven, 1);
    put(frame, flags, 1);
    put(frame, core->trip, 1);
    put(frame, core->config, 2);
    put(frame, core->pulses, 4);
    put(frame, core->exposures, 2);
    put(frame, core->faulty, 2);
}

void gk_answer(const gk_core *core, gk_outputs *out) {
    static const uint8_t digits[] = "0123456789ABCDEF";
    frame_out frame;
    memset(&frame, 0, sizeof frame);
    put(&frame, core->answer_number, 2);
    put(&frame, core->answer_command | 0x80u, 1);
    put(&frame, core->board.epoch, 2);
    put(&frame, core->answer_status, 1);
    if (core->answer_command == GK_HELLO && core->answer_status == GK_OK) put_identity(core, &frame);
    else put_state(core, &frame);
    put(&frame, gk_crc(0xFFFFu, frame.bytes, frame.num_bytes), 2);
    out->bytes[out->num_bytes++] = ':';
    for (uint8_t i = 0; i < frame.num_bytes; i++) {
        out->bytes[out->num_bytes++] = digits[frame.bytes[i] >> 4];
        out->bytes[out->num_bytes++] = digits[frame.bytes[i] & 15u];
    }
    out->bytes[out->num_bytes++] = '\n';
}
