/* Sizes as the compiler of the firmware has them, so that nobody has to believe that both sides agree. */
#include "gatekeeper_core.h"

size_t gk_size_of_core(void) { return sizeof(gk_core); }
size_t gk_size_of_board(void) { return sizeof(gk_board); }
size_t gk_size_of_inputs(void) { return sizeof(gk_inputs); }
size_t gk_size_of_outputs(void) { return sizeof(gk_outputs); }
