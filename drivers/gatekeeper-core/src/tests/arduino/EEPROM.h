#pragma once
#include <cstdint>
struct FakeMemory {
  uint8_t bytes[2] = {0xFF, 0xFF};
  uint8_t read(int at) { return bytes[at]; }
  void write(int at, uint8_t byte) { bytes[at] = byte; }
};
static FakeMemory EEPROM;
