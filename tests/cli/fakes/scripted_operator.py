"""Stand-in for tandem_operator: is there until asked to go."""

import os
import signal
import sys
import time

if "--check" in sys.argv:
    sys.exit(0)
signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
while os.environ.get("FAKE_OPERATOR") != "die":
    time.sleep(0.05)
time.sleep(0.3)
print("the operator has had enough", flush=True)
sys.exit(7)
