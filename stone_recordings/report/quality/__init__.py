"""Quality of a recording: facts measured on a share of it, a score with named deductions, a page that shows both.

**Conventions.** `report.quality_of` measures, `page.quality_page` draws. Both are functions of the recording alone, so
whoever repeats them gets the same bytes. Cost is bounded whatever the recording: `sampling` says by what.
"""
