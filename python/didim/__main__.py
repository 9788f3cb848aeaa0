"""``python -m didim``."""

import sys

from .cli.main import main

sys.exit(main())
