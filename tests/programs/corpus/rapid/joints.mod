MODULE Joints
  CONST jointtarget jHome:=[[0,-15,20,0,40,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PERS jointtarget jService:=[[35.5,-30,+25.25,-1e1,55,.5],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  LOCAL VAR jointtarget jFold{2}:=[[[10,10,10,10,30,10],[9E9,9E9,9E9,9E9,9E9,9E9]],[[-10,10,-10,10,50,-10],[9E9,9E9,9E9,9E9,9E9,9E9]]];
  PROC Home()
    MoveAbsJ jHome\NoEOffs, v500, fine, tool0;
    MoveAbsJ jService, v500, z100, torch\WObj:=table;
    MoveAbsJ jFold{1}\NoEOffs,v500,z50,tool0;
    MoveAbsJ jFold{2}\NoEOffs,v500,z50,tool0;
  ENDPROC
ENDMODULE
