"""Quality of a recording: facts measured on a sample, a score with named deductions, and a page with both.

**Conventions.** `report.quality_of` measures, `page.quality_page` draws. Both are functions of the recording alone, so
a repetition gives the same bytes. `sampling` bounds their cost for any recording.
"""
