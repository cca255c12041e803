// Switches the board on and lets it turn while a hello comes in.
#include "Arduino.h"
#include "../../../../gatekeeper/firmware/gatekeeper/gatekeeper.ino"

int main() {
  setup();
  for (int turn = 0; turn < 40; turn++) loop();
  return 0;
}
