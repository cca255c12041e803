// As much of an Arduino as the shell of the firmware uses; every call is printed.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstring>

enum { LOW = 0, HIGH = 1, INPUT = 0, OUTPUT = 1, INPUT_PULLUP = 2 };

static uint32_t clock_us = 0;
static inline uint32_t micros() { return clock_us += 100; }
static inline void digitalWrite(uint8_t pin, int level) { std::printf("write %d %d\n", pin, level); }
static inline void analogWrite(uint8_t pin, int level) { std::printf("analog %d %d\n", pin, level); }
static inline int digitalRead(uint8_t) { return LOW; }
static inline void pinMode(uint8_t pin, int mode) {
  std::printf(mode == OUTPUT ? "output %d\n" : "input %d\n", pin);
}

struct FakeSerial {
  const char *waiting = ":00010100005088\n";
  void begin(long) { std::printf("serial\n"); }
  int available() { return static_cast<int>(std::strlen(waiting)); }
  int read() { return *waiting++; }
  int availableForWrite() { return 63; }
  void write(const uint8_t *bytes, int num_bytes) {
    std::printf("sent %.*s", num_bytes, reinterpret_cast<const char *>(bytes));
  }
};
static FakeSerial Serial;

#if defined(__IMXRT1062__)
static uint32_t CCM_CCGR3, WDOG1_WMCR, WDOG1_WCR;
static struct Service {
  void operator=(int value) { if (value == 0xAAAA) std::printf("feeds\n"); }
} WDOG1_WSR;
#define CCM_CCGR3_WDOG1(n) static_cast<uint32_t>(n)
#define CCM_CCGR_ON 3
enum { WDOG_WCR_WDZST = 1, WDOG_WCR_SRS = 16, WDOG_WCR_WDA = 32, WDOG_WCR_WDE = 4 };
#define WDOG_WCR_WT(n) (static_cast<uint32_t>(n) << 8)
#endif
