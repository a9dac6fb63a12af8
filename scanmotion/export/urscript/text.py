"""The text of a URScript programme around the moves, and of its table's drive.

`@` stands for the programme's name. Lines that begin with `?word ` are kept where the cell has that signal.
"""

HEAD = """def @():
  global @_step = 0
  global @_at = 0
  global @_bad = False
  global @_on = False
  global @_clock = 0.0
  global @_due = 0.0
  global @_low = 1000000.0
  global @_start = {start}
  global @_q = {start}
  global @_v = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]

  def @_say_start():
    popup("the robot is not at the start: drive it there by hand", title="scan", error=True, blocking=True)
  end

  def @_check():
    # nothing moves before the arm stands at the start
    local there = False
    local q = get_actual_joint_positions()
    local i = 0
    while not there:
      q = get_actual_joint_positions()
      there = True
      i = 0
      while i < 6:
        if abs(q[i] - @_start[i]) > {near}:
          there = False
        end
        i = i + 1
      end
      if not there:
        @_say_start()
      end
    end
  end

  def @_now(n):
    # the step that begins, as a variable and as a word of outputs
    global @_step = n
    global @_at = 0
?word     local bits = integer_to_binary_list(n)
{word}
  end

  def @_lost():
    # the table does not do its part of the step: nobody knows what is in the way
    stopj(2.0)
    {table_start_off}
?start     {start_off}
    popup("the table has stopped: drive out by hand", title="scan", error=True, blocking=True)
    halt
  end

  def @_tick():
    # after each 10 ms: the frames' pulses, and what stops the step
?frame     if @_on:
?frame       global @_clock = @_clock + 0.01
?frame       if @_clock >= @_due:
?frame         {frame_on}
?frame         global @_low = @_due + {half}
?frame         global @_due = @_due + {every}
?frame       end
?frame       if @_clock >= @_low:
?frame         {frame_off}
?frame         global @_low = 1000000.0
?frame       end
?frame     end
?fault     if @_on:
?fault       if {fault_in}:
?fault         global @_bad = True
?fault       end
?fault     end
?tfault     if {table_fault_in}:
?tfault       @_lost()
?tfault     end
  end

  def @_to(q, v, n):
    # n times 10 ms on a cubic from where the last one ended, with its speed, to q with the speed v
    local i = 1.0
    local h = n * 0.01
    local s = 0.0
    local a = 0.0
    local b = 0.0
    local c = 0.0
    local d = 0.0
    while i <= n and not @_bad:
      s = i / n
      a = s * s * (3.0 - 2.0 * s)
      b = s * (1.0 - s) * (1.0 - s) * h
      c = s * s * (s - 1.0) * h
      d = 1.0 - a
{servo}
      @_tick()
      i = i + 1.0
    end
    global @_q = q
    global @_v = v
  end

  def @_hold(n):
    # n times 10 ms where the arm stands
    local i = 1.0
    while i <= n and not @_bad:
      sleep(0.01)
      @_tick()
      i = i + 1.0
    end
  end

  def @_table_ready():
    # the table stands where the step begins
{table_ready}
  end

  def @_table_go():
    # the table's drive begins {lag} s after this signal, and so does the arm
    @_table_ready()
    {table_start_on}
    sleep({lag})
    if {table_ready_in}:
      @_lost()
    end
  end

  def @_table_end():
    {table_start_off}
    @_table_ready()
  end

?scan   def @_scan_on():
?scan     global @_bad = False
?ready {ready}
?start     {start_on}
?scan     global @_clock = 0.0
?scan     global @_due = 0.0
?scan     global @_on = True
?scan     @_tick()
?scan   end

?scan   def @_scan_off():
?scan     global @_on = False
?frame     {frame_off}
?start     {start_off}
?done {done}
?scan   end

?fault   def @_table_back():
?fault     # the drive turns back to where the step begins
?fault {table_back}
?fault   end

?fault   def @_broken():
?fault     # a fault of the scanner: the arm and the table stop
?fault     stopj(2.0)
?fault     global @_on = False
?frame     {frame_off}
?start     {start_off}
?fault     {table_start_off}
?fault     popup("scanner fault: the step is repeated", title="scan", error=True, blocking=True)
?fault   end
"""

SERVO = (
    "      servoj([{terms}], 0, 0, 0.01, 0.03, 500)",
    "{d}*@_q[{i}]+a*q[{i}]+b*@_v[{i}]+c*v[{i}]",
)
"""A cubic of Hermite; the cycle of 10 ms is five of an e-Series' controller."""

AWAITED = """    local waited = 0.0
    while not {signal}:
      sleep(0.01)
      waited = waited + 0.01
      if waited >= {seconds}:
        popup("{text}", title="scan", error=True, blocking=True)
        waited = 0.0
      end
    end"""

START = """
  set_tcp({tcp})
  set_payload({mass}, {centre})
  {table_start_off}
?start   {start_off}
  @_now(0)
  @_check()
  @_table_ready()
  movej(@_start, a=0.3, v=0.1)
"""

FINISH = """  @_now(0)
end
"""

TABLE = """PROGRAM @_table
VAR_INPUT
Start : BOOL;
ArmRuns : BOOL;
Step : INT;
END_VAR
VAR_OUTPUT
Ready : BOOL;
Fault : BOOL;
END_VAR
VAR_IN_OUT
Table : AXIS_REF;
END_VAR
VAR
State : INT := 0;
Over : INT := 0;
There : BOOL;
First : LREAL;
Way : MC_TP_REF;
Late : TON;
Profile : MC_PositionProfile;
Stand : MC_Halt;
Back : MC_MoveAbsolute;
END_VAR
"""

TABLE_STATES = """Late(IN := Start AND (State = 1), PT := T#{lag}ms);
Profile(Axis := Table, TimePosition := Way, Execute := Late.Q AND (State = 1));
Stand(Axis := Table, Execute := (State = 3) OR (State = 9), Deceleration := {slow_down});
Back(Axis := Table, Position := First, Velocity := {slow}, Execute := (State = 4));
There := ABS(Table.ActPos - First) <= {near};
CASE State OF
0:
IF Start AND There THEN State := 1;
ELSIF Start THEN State := 9; END_IF;
1:
IF Profile.Error OR NOT ArmRuns THEN State := 9;
ELSIF Profile.Done THEN State := 2; Over := Step;
ELSIF NOT Start THEN State := 3; END_IF;
2:
IF NOT Start THEN State := 5; END_IF;
3:
IF Stand.Error OR NOT ArmRuns THEN State := 9;
ELSIF Stand.Done THEN State := 4; END_IF;
4:
IF Back.Error OR NOT ArmRuns THEN State := 9;
ELSIF Back.Done THEN State := 0; END_IF;
5:
IF Step <> Over THEN State := 0;
ELSIF Start THEN State := 9; END_IF;
9:
IF NOT Start AND ArmRuns THEN State := 0; END_IF;
END_CASE;
Ready := ((State = 0) AND There) OR (State = 5);
Fault := (State = 9);
END_PROGRAM
"""
"""0 stands at a step's begin, 1 the step, 2 its end, 3 halts, 4 the way back, 5 at the end, 9 fault."""
