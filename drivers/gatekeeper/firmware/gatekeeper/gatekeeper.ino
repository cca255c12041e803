// Gatekeeper on an Arduino Uno or a Teensy 4: pins, serial port and clock around gatekeeper_core.
// Outputs are driven low before anything else; README.md tells the wiring and how to flash.
#include "gatekeeper_core.h"

#include <EEPROM.h>

// Each board has a number of its own, so that the program never takes one for another.
#ifndef GATEKEEPER_SERIAL
#define GATEKEEPER_SERIAL 1ul
#endif

#if defined(__IMXRT1062__)
static const uint8_t GATE_PINS[] = {9, 10, 11, 12, 14, 15, 16, 17};
static const uint8_t LEVEL_PINS[] = {3, 4, 5, 6};
static const uint8_t PULSE_PIN = 13, INTERLOCK_PIN = 1, EXPOSURE_PIN = 0;
#elif defined(__AVR__)
#include <avr/wdt.h>
// Not 13, which the boot loader blinks; 14 is A0.
static const uint8_t GATE_PINS[] = {7, 8, 9, 10, 12, 14};
// 3 and 11 share a timer of their own, so that millis() and micros() keep their time.
static const uint8_t LEVEL_PINS[] = {3, 11};
static const uint8_t PULSE_PIN = 6, INTERLOCK_PIN = 4, EXPOSURE_PIN = 2;
#else
#error "gatekeeper knows the Arduino Uno and the Teensy 4.0 and 4.1: give it the pins of this board"
#endif

static const uint8_t NUM_GATES = sizeof GATE_PINS;
static const uint8_t NUM_LEVELS = sizeof LEVEL_PINS;

static gk_core core;
static gk_outputs outputs;

// The last line: a board that hangs is reset, and a reset board is dark.
static void begin_hardware_watchdog() {
#if defined(__AVR__)
  wdt_enable(WDTO_120MS);
#else
  CCM_CCGR3 |= CCM_CCGR3_WDOG1(CCM_CCGR_ON);
  WDOG1_WMCR = 0;
  WDOG1_WCR = WDOG_WCR_WDZST | WDOG_WCR_SRS | WDOG_WCR_WDA | WDOG_WCR_WT(0) | WDOG_WCR_WDE;  // 0.5 s
#endif
}

static void feed_hardware_watchdog() {
#if defined(__AVR__)
  wdt_reset();
#else
  WDOG1_WSR = 0x5555;
  WDOG1_WSR = 0xAAAA;
#endif
}

static void write_outputs() {
  for (uint8_t gate = 0; gate < NUM_GATES; gate++) {
    digitalWrite(GATE_PINS[gate], (outputs.gates >> gate) & 1 ? HIGH : LOW);
  }
  digitalWrite(PULSE_PIN, outputs.pulse ? HIGH : LOW);
  static uint16_t written[GK_LEVELS];
  for (uint8_t level = 0; level < NUM_LEVELS; level++) {
    if (written[level] == outputs.levels[level]) continue;
    written[level] = outputs.levels[level];
    analogWrite(LEVEL_PINS[level], written[level] >> 4);
  }
}

// Another number after every reset; 0 is never used.
static uint16_t next_epoch() {
  uint16_t epoch = (uint16_t)(EEPROM.read(0) << 8 | EEPROM.read(1));
  if (++epoch == 0) epoch = 1;
  EEPROM.write(0, epoch >> 8);
  EEPROM.write(1, epoch & 0xFF);
  return epoch;
}

void setup() {
  for (uint8_t gate = 0; gate < NUM_GATES; gate++) {
    digitalWrite(GATE_PINS[gate], LOW);
    pinMode(GATE_PINS[gate], OUTPUT);
  }
  for (uint8_t level = 0; level < NUM_LEVELS; level++) {
    digitalWrite(LEVEL_PINS[level], LOW);
    pinMode(LEVEL_PINS[level], OUTPUT);
  }
  digitalWrite(PULSE_PIN, LOW);
  pinMode(PULSE_PIN, OUTPUT);
  // Closed pulls the pin to ground: a broken wire is an open interlock.
  pinMode(INTERLOCK_PIN, INPUT_PULLUP);
  pinMode(EXPOSURE_PIN, INPUT);
  gk_board board = {GATEKEEPER_SERIAL, next_epoch(), NUM_GATES, NUM_LEVELS, 0};
  gk_power_up(&core, &board, micros());
  Serial.begin(115200);
  begin_hardware_watchdog();
}

void loop() {
  gk_inputs inputs;
  inputs.now_us = micros();
  inputs.byte = Serial.available() > 0 ? (int16_t)Serial.read() : -1;
  inputs.interlock_closed = digitalRead(INTERLOCK_PIN) == LOW;
  inputs.exposing = digitalRead(EXPOSURE_PIN) == HIGH;
  gk_step(&core, &inputs, &outputs);
  write_outputs();
  // An answer that does not fit is not sent: the host asks again, the gates never wait.
  if (outputs.num_bytes > 0 && Serial.availableForWrite() >= outputs.num_bytes) {
    Serial.write(outputs.bytes, outputs.num_bytes);
  }
  feed_hardware_watchdog();
}
