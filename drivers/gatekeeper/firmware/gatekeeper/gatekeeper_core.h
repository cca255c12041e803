/* Gatekeeper: trigger controller that lets laser light through only while somebody holds it.
 *
 * In: time, one received byte at a time, level of the interlock, level of the camera's exposure output.
 * Out: levels of all pins, and bytes to send. Never: waits, allocates, reads a clock, touches a pin.
 * Fails: closed. Every gate is low after reset, after a trip, without heartbeats, with the interlock open, and
 * after its longest time; see ../PROTOCOL.md for the words on the line.
 *
 * The same file runs on the board (gatekeeper.ino) and inside the virtual board of the tests.
 */
#ifndef GATEKEEPER_CORE_H
#define GATEKEEPER_CORE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define GK_PROTOCOL 1u
#define GK_FIRMWARE 1u
#define GK_GATES 8u
#define GK_LEVELS 4u
#define GK_SEQUENCE 256u
/* Greatest level of an analog output: 12 bits. */
#define GK_LEVEL_MAX 4095u
/* Gates close when the last heartbeat is this old. No command changes it. */
#define GK_WATCHDOG_US 250000ul
/* Longest on-time of a gate after reset, and the longest that can be asked for: half an hour. */
#define GK_ON_TIME_US 1000000ul
#define GK_ON_TIME_MAX_US 1800000000ul
/* Periods of the train of pulses. */
#define GK_PERIOD_MIN_US 100ul
#define GK_PERIOD_MAX_US 60000000ul

/* Bytes of a frame between ':' and the end of the line, before they are written in hexadecimal. */
#define GK_HEADER 5u
#define GK_PAYLOAD 20u
#define GK_FRAME (GK_HEADER + GK_PAYLOAD + 2u)
#define GK_LINE (2u * GK_FRAME + 2u)

enum gk_command {
    GK_HELLO = 0x01, GK_ARM = 0x02, GK_DISARM = 0x03, GK_HEARTBEAT = 0x04, GK_SET_GATES = 0x05,
    GK_SET_LEVEL = 0x06, GK_SET_LIMIT = 0x07, GK_LOAD = 0x08, GK_BEGIN = 0x09, GK_END = 0x0A,
    GK_TRAIN = 0x0B, GK_TRAIN_STOP = 0x0C, GK_STATE = 0x0D
};

enum gk_status {
    GK_OK = 0, GK_UNKNOWN = 1, GK_LENGTH = 2, GK_RANGE = 3, GK_NOT_ARMED = 4, GK_INTERLOCK_OPEN = 5,
    GK_BUSY = 6, GK_NUMBER = 7, GK_EPOCH = 8, GK_CONTENT = 9
};

enum gk_trip {
    GK_TRIP_NONE = 0, GK_TRIP_WATCHDOG = 1, GK_TRIP_ON_TIME = 2, GK_TRIP_INTERLOCK = 3,
    GK_TRIP_COMMANDED = 4, GK_TRIP_RESET = 5
};

enum gk_stepping { GK_STEP_NONE = 0xFF, GK_STEP_EXPOSURE = 0, GK_STEP_CLOCK = 1 };

/* What a board is, and how often it has been switched on. */
typedef struct {
    uint32_t serial;
    /* Another number after every reset, never 0. */
    uint16_t epoch;
    uint8_t gates;
    uint8_t levels;
    /* 1 for anything that is not a physical board. */
    uint8_t simulated;
} gk_board;

typedef struct {
    uint32_t now_us;
    /* The next received byte, or -1. */
    int16_t byte;
    uint8_t interlock_closed;
    /* Level of the camera's exposure output. */
    uint8_t exposing;
} gk_inputs;

typedef struct {
    uint16_t levels[GK_LEVELS];
    uint8_t gates;
    /* Level of the line that starts exposures. */
    uint8_t pulse;
    uint8_t num_bytes;
    uint8_t bytes[GK_LINE];
} gk_outputs;

typedef struct {
    gk_board board;
    uint32_t now_us;

    /* Frame that is coming in. */
    uint8_t frame[GK_FRAME];
    uint8_t num_digits;
    uint8_t in_frame;

    /* The command before: one that comes again is answered again and not done again. */
    uint16_t number;
    uint16_t check;
    uint8_t status;
    uint8_t greeted;
    /* What is answered at the end of this step. */
    uint16_t answer_number;
    uint8_t answer_command;
    uint8_t answer_status;

    uint8_t armed;
    uint8_t trip;
    uint8_t interlock_closed;
    uint8_t exposing;
    uint32_t alive_us;
    uint8_t wanted;
    uint8_t driven;
    uint32_t limit_us[GK_GATES];
    uint32_t opened_us[GK_GATES];
    uint16_t levels[GK_LEVELS];
    uint16_t config;

    uint8_t patterns[GK_SEQUENCE];
    uint16_t length;
    uint16_t next;
    uint8_t stepping;
    /* Whether an exposure that began after the sequence did is under way. */
    uint8_t showing;
    uint8_t shown;

    uint8_t running;
    uint8_t finite;
    uint32_t left;
    uint32_t begun_us;
    uint32_t period_us;
    uint32_t width_us;
    uint32_t delay_us;
    uint32_t open_us;

    uint32_t pulses;
    uint16_t exposures;
    uint16_t faulty;
} gk_core;

/* The state after reset: everything low, nothing armed. */
void gk_power_up(gk_core *core, const gk_board *board, uint32_t now_us);

/* One turn of the main loop; the outputs are valid at once, gates first. */
void gk_step(gk_core *core, const gk_inputs *in, gk_outputs *out);

/* Microseconds after the last step until outputs can change without any input; at most a second. */
uint32_t gk_idle_us(const gk_core *core);

/* CRC-16/CCITT-FALSE: polynomial 0x1021, begins with 0xFFFF; 0x29B1 for "123456789". */
uint16_t gk_crc(uint16_t crc, const uint8_t *bytes, size_t num_bytes);

/* Between the two files of the firmware. */
uint8_t gk_receive(gk_core *core, uint8_t byte);
void gk_answer(const gk_core *core, gk_outputs *out);
uint8_t gk_execute(gk_core *core, uint8_t command, const uint8_t *payload, uint8_t length);
uint8_t gk_closes(uint8_t command, const uint8_t *payload, uint8_t length);
void gk_close_for(gk_core *core, uint8_t trip);
void gk_configured(gk_core *core);

#ifdef __cplusplus
}
#endif

#endif
