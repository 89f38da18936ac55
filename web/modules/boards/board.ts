// The board's page: the slider of its history, the choice of two entries, the table for a paper.

import { installCopying } from "./copying.js";
import { installHistory } from "./history.js";
import { installPicking } from "./picking.js";

installHistory();
installPicking();
installCopying();
