from headcap.workflow.progress import Progress

START = """Job stats:
job            count
-----------  -------
ingest             2
reconstruct        4
all                1
total              7
""".splitlines()


def job(rule: str, jobid: int, wildcards: str) -> list[str]:
    return [f"rule {rule}:", f"    jobid: {jobid}", f"    wildcards: {wildcards}"]


def done(rule: str, jobid: int, steps: int) -> list[str]:
    return [f"Finished jobid: {jobid} (Rule: {rule})", f"{steps} of 7 steps ({100 * steps // 7}%) done"]


def test_stage_chunk_and_time_left_are_told() -> None:
    now = [0.0]
    progress = Progress(clock=lambda: now[0])

    def follow(lines: list[str]) -> list[str]:
        return [told for line in lines if (told := progress.follow(line))]

    assert follow(START) == []
    assert follow(job("ingest", 1, "session=demo, recording=free_01")) == ["ingest demo, free_01"]
    now[0] = 10.0
    # one of two such jobs and, as long as nothing else is known, five that take as long: 6 x 10 s
    assert follow(done("ingest", 1, 1)) == ["[1/7] about 1 min 00 s left"]
    follow(job("reconstruct", 2, "session=demo, take=free_01, chunk=000"))
    now[0] = 40.0
    # elapsed 40 s for 40 s of jobs; left: ingest 10 s, reconstruct 3 x 30 s, all as the mean job 20 s
    assert follow(done("reconstruct", 2, 2)) == ["[2/7] about 2 min 00 s left"]


def test_lines_of_stages_are_passed_on_and_others_are_not() -> None:
    progress = Progress()
    assert (
        progress.follow("headcap: reconstruct free_01 frame 3: 120000 points\n") == "reconstruct free_01 frame 3: 120000 points"
    )
    assert progress.follow("Select jobs to execute...\n") is None
    assert progress.time_left() == "time left is not known yet"
