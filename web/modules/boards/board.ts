// The board's page: the slider of its history, the choice of two entries, the table for a paper.

import { installCopying } from "./table_copy.js";
import { installHistory } from "./history.js";
import { installPicking } from "./entry_choice.js";

installHistory();
installPicking();
installCopying();
