/* What gates, levels and pulses do: the part that decides about light. */

#include "gatekeeper_core.h"

#include <string.h>

static uint8_t all_gates(const gk_core *core) {
    return (uint8_t)((1u << core->board.gates) - 1u);
}

static uint32_t long_at(const uint8_t *bytes) {
    return ((uint32_t)bytes[0] << 24) | ((uint32_t)bytes[1] << 16) | ((uint32_t)bytes[2] << 8) | bytes[3];
}

static uint16_t short_at(const uint8_t *bytes) {
    return (uint16_t)(((uint16_t)bytes[0] << 8) | bytes[1]);
}

/* Forgets what should be open; gates follow at the end of the step. */
static void forget_gates(gk_core *core) {
    core->wanted = 0;
    core->stepping = GK_STEP_NONE;
    core->showing = 0;
}

void gk_close_for(gk_core *core, uint8_t trip) {
    forget_gates(core);
    core->armed = 0;
    if (core->trip == GK_TRIP_NONE) core->trip = trip;
}

void gk_configured(gk_core *core) {
    uint16_t crc = gk_crc(0xFFFFu, &core->board.gates, 1);
    for (uint8_t gate = 0; gate < GK_GATES; gate++) {
        uint32_t limit = core->limit_us[gate];
        uint8_t bytes[4] = {(uint8_t)(limit >> 24), (uint8_t)(limit >> 16), (uint8_t)(limit >> 8), (uint8_t)limit};
        crc = gk_crc(crc, bytes, sizeof bytes);
    }
    core->config = crc;
}

void gk_power_up(gk_core *core, const gk_board *board, uint32_t now_us) {
    memset(core, 0, sizeof *core);
    core->board = *board;
    if (core->board.gates > GK_GATES) core->board.gates = GK_GATES;
    if (core->board.levels > GK_LEVELS) core->board.levels = GK_LEVELS;
    core->now_us = now_us;
    core->trip = GK_TRIP_RESET;
    core->stepping = GK_STEP_NONE;
    for (uint8_t gate = 0; gate < GK_GATES; gate++) core->limit_us[gate] = GK_ON_TIME_US;
    gk_configured(core);
}

uint8_t gk_closes(uint8_t command, const uint8_t *payload, uint8_t length) {
    return ((command == GK_DISARM || command == GK_END || command == GK_TRAIN_STOP) && length == 0)
        || (command == GK_SET_GATES && length == 1 && payload[0] == 0);
}

static uint8_t arm(gk_core *core, const uint8_t *payload) {
    if (!core->interlock_closed) return GK_INTERLOCK_OPEN;
    if (short_at(payload) != core->config) return GK_CONTENT;
    forget_gates(core);
    core->trip = GK_TRIP_NONE;
    core->armed = 1;
    core->alive_us = core->now_us;
    return GK_OK;
}

static uint8_t set_gates(gk_core *core, uint8_t pattern) {
    if (pattern == 0) {
        forget_gates(core);
        return GK_OK;
    }
    if (pattern & (uint8_t)~all_gates(core)) return GK_RANGE;
    if (!core->armed) return GK_NOT_ARMED;
    if (core->stepping != GK_STEP_NONE) return GK_BUSY;
    core->wanted = pattern;
    return GK_OK;
}

static uint8_t set_level(gk_core *core, const uint8_t *payload) {
    uint16_t level = short_at(payload + 1);
    if (payload[0] >= core->board.levels || level > GK_LEVEL_MAX) return GK_RANGE;
    core->levels[payload[0]] = level;
    return GK_OK;
}

static uint8_t set_limit(gk_core *core, const uint8_t *payload) {
    uint32_t limit = long_at(payload + 1);
    if (payload[0] >= core->board.gates || limit == 0 || limit > GK_ON_TIME_MAX_US) return GK_RANGE;
    if (core->armed) return GK_BUSY;
    core->limit_us[payload[0]] = limit;
    gk_configured(core);
    return GK_OK;
}

static uint8_t load(gk_core *core, const uint8_t *payload, uint8_t length) {
    uint16_t at = short_at(payload);
    uint8_t num_patterns = (uint8_t)(length - 2u);
    if (at > GK_SEQUENCE || num_patterns > GK_SEQUENCE - at) return GK_RANGE;
    if (core->stepping != GK_STEP_NONE) return GK_BUSY;
    for (uint8_t i = 0; i < num_patterns; i++) {
        if (payload[2 + i] & (uint8_t)~all_gates(core)) return GK_RANGE;
    }
    memcpy(core->patterns + at, payload + 2, num_patterns);
    return GK_OK;
}

static uint8_t begin(gk_core *core, const uint8_t *payload) {
    uint16_t length = short_at(payload);
    uint8_t stepping = payload[4];
    if (length == 0 || length > GK_SEQUENCE || stepping > GK_STEP_CLOCK) return GK_RANGE;
    if (gk_crc(0xFFFFu, core->patterns, length) != short_at(payload + 2)) return GK_CONTENT;
    if (!core->armed) return GK_NOT_ARMED;
    if (core->stepping != GK_STEP_NONE) return GK_BUSY;
    forget_gates(core);
    core->length = length;
    core->next = 0;
    core->exposures = 0;
    core->stepping = stepping;
    return GK_OK;
}

static void next_pattern(gk_core *core) {
    core->shown = core->patterns[core->next];
    core->next = (uint16_t)((core->next + 1u) % core->length);
    core->showing = 1;
    core->exposures++;
}

static void pulse(gk_core *core) {
    core->pulses++;
    if (core->finite) core->left--;
    if (core->stepping == GK_STEP_CLOCK) next_pattern(core);
}

static uint8_t start_train(gk_core *core, const uint8_t *payload) {
    uint32_t period = long_at(payload), number = long_at(payload + 4), width = long_at(payload + 8);
    uint32_t delay = long_at(payload + 12), open = long_at(payload + 16);
    if (period < GK_PERIOD_MIN_US || period > GK_PERIOD_MAX_US) return GK_RANGE;
    if (width == 0 || width >= period || delay >= period || open > period - delay) return GK_RANGE;
    if (core->running) return GK_BUSY;
    core->period_us = period;
    core->width_us = width;
    core->delay_us = delay;
    core->open_us = open;
    core->finite = number != 0;
    core->left = number;
    core->running = 1;
    core->begun_us = core->now_us;
    pulse(core);
    return GK_OK;
}

static uint8_t length_fits(uint8_t command, uint8_t length) {
    switch (command) {
        case GK_ARM: return length == 2;
        case GK_SET_GATES: return length == 1;
        case GK_SET_LEVEL: return length == 3;
        case GK_SET_LIMIT: return length == 5;
        case GK_LOAD: return length > 2;
        case GK_BEGIN: return length == 5;
        case GK_TRAIN: return length == 20;
        default: return length == 0;
    }
}

uint8_t gk_execute(gk_core *core, uint8_t command, const uint8_t *payload, uint8_t length) {
    if (!length_fits(command, length)) return GK_LENGTH;
    switch (command) {
        case GK_ARM: return arm(core, payload);
        case GK_DISARM: forget_gates(core); core->armed = 0; return GK_OK;
        case GK_HEARTBEAT:
            if (!core->armed) return GK_NOT_ARMED;
            core->alive_us = core->now_us;
            return GK_OK;
        case GK_SET_GATES: return set_gates(core, payload[0]);
        case GK_SET_LEVEL: return set_level(core, payload);
        case GK_SET_LIMIT: return set_limit(core, payload);
        case GK_LOAD: return load(core, payload, length);
        case GK_BEGIN: return begin(core, payload);
        case GK_END: forget_gates(core); return GK_OK;
        case GK_TRAIN: return start_train(core, payload);
        case GK_TRAIN_STOP: core->running = 0; return GK_OK;
        case GK_STATE: return GK_OK;
        default: return GK_UNKNOWN;
    }
}

/* Unsigned differences are right across the wrap of the clock after 71 minutes. */
static uint32_t since(const gk_core *core, uint32_t then_us) {
    return core->now_us - then_us;
}

static void run_train(gk_core *core) {
    if (!core->running || since(core, core->begun_us) < core->period_us) return;
    if (core->finite && core->left == 0) {
        core->running = 0;
        return;
    }
    core->begun_us += core->period_us;
    /* A board that was late by more than a period goes on from here, not in a burst. */
    if (since(core, core->begun_us) >= core->period_us) core->begun_us = core->now_us;
    pulse(core);
}

static void follow_camera(gk_core *core, uint8_t exposing) {
    uint8_t begins = exposing && !core->exposing;
    core->exposing = exposing;
    if (core->stepping != GK_STEP_EXPOSURE) return;
    if (begins) next_pattern(core);
    else if (!exposing) core->showing = 0;
}

/* The pattern of a sequence at this moment. */
static uint8_t stepped(const gk_core *core) {
    uint32_t into = since(core, core->begun_us);
    if (!core->showing) return 0;
    if (core->stepping == GK_STEP_EXPOSURE) return core->shown;
    return core->running && into >= core->delay_us && into - core->delay_us < core->open_us ? core->shown : 0;
}

/* Every way to an open gate leads through here. */
static void drive(gk_core *core) {
    uint8_t pattern = 0;
    if (core->armed && core->trip == GK_TRIP_NONE && core->interlock_closed) {
        pattern = core->stepping == GK_STEP_NONE ? core->wanted : stepped(core);
        pattern &= all_gates(core);
    }
    for (uint8_t gate = 0; gate < GK_GATES; gate++) {
        uint8_t bit = (uint8_t)(1u << gate);
        if (!(pattern & bit)) continue;
        if (!(core->driven & bit)) core->opened_us[gate] = core->now_us;
        else if (since(core, core->opened_us[gate]) >= core->limit_us[gate]) {
            gk_close_for(core, GK_TRIP_ON_TIME);
            pattern = 0;
        }
    }
    core->driven = pattern;
}

void gk_step(gk_core *core, const gk_inputs *in, gk_outputs *out) {
    uint8_t answers = 0;
    core->now_us = in->now_us;
    core->interlock_closed = in->interlock_closed != 0;
    if (core->armed && !core->interlock_closed) gk_close_for(core, GK_TRIP_INTERLOCK);
    if (core->armed && since(core, core->alive_us) >= GK_WATCHDOG_US) gk_close_for(core, GK_TRIP_WATCHDOG);
    run_train(core);
    follow_camera(core, in->exposing != 0);
    if (in->byte >= 0) answers = gk_receive(core, (uint8_t)in->byte);
    drive(core);

    memset(out, 0, sizeof *out);
    out->gates = core->driven;
    out->pulse = core->running && since(core, core->begun_us) < core->width_us;
    for (uint8_t level = 0; level < GK_LEVELS; level++) out->levels[level] = core->armed ? core->levels[level] : 0;
    if (answers) gk_answer(core, out);
}

static uint32_t sooner(uint32_t idle, uint32_t total, uint32_t gone) {
    return total > gone && total - gone < idle ? total - gone : idle;
}

uint32_t gk_idle_us(const gk_core *core) {
    uint32_t idle = 1000000ul;
    if (core->armed) idle = sooner(idle, GK_WATCHDOG_US, since(core, core->alive_us));
    for (uint8_t gate = 0; gate < GK_GATES; gate++) {
        if (core->driven & (1u << gate)) idle = sooner(idle, core->limit_us[gate], since(core, core->opened_us[gate]));
    }
    if (core->running) {
        uint32_t into = since(core, core->begun_us);
        idle = sooner(idle, core->period_us, into);
        idle = sooner(idle, core->width_us, into);
        idle = sooner(idle, core->delay_us, into);
        idle = sooner(idle, core->delay_us + core->open_us, into);
    }
    return idle;
}
