#pragma once
#include <cstdio>
enum { WDTO_120MS = 3 };
static inline void wdt_enable(int) {}
static inline void wdt_reset() { std::printf("feeds\n"); }
